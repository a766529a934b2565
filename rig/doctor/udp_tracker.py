"""Check of a rig's tracker that sends UDP datagrams."""

from __future__ import annotations

from contextlib import closing

from rig.config.drivers import Finding
from rig.config.schema import RigConfig
from rig.config.tracker_sections import UdpTrackerConfig
from rig.hardware.trackers.base import TrackerError, open_tracker
from runs.records import DATAGRAM_COUNTS

LISTENS_S = 1.5
"""Time in which a sender's clock becomes known and a pose comes."""


def examine(config: RigConfig, name: str) -> list[Finding]:
    """Listen for poses; none come while a run uses the port."""
    tracker = config.trackers[name]
    assert isinstance(tracker, UdpTrackerConfig)
    return [_listen(config, name, tracker)]


def _listen(config: RigConfig, name: str, tracker: UdpTrackerConfig) -> Finding:
    topic, place = f"rig's tracker {name}", f"UDP {tracker.address}:{tracker.port}"
    try:
        with closing(open_tracker(config, name)) as source:
            reading = source.read(LISTENS_S)
            counts = source.counts()
    except TrackerError as error:
        return Finding(topic, "missing", str(error), "end the other program, or state another port")
    if reading is not None:
        clock = reading.clock
        found = (
            f"poses at {place} from {tracker.sender}; its clock drifts by {clock.drift * 1e6:+.0f} ppm, "
            f"times are known to {reading.time_std_s * 1e3:.2f} ms beside the constant delay"
        )
        return Finding(topic, "ok", found, "nothing")
    unused = ", ".join(f"{n} {what.replace('_', ' ')}" for what, n in zip(DATAGRAM_COUNTS, counts, strict=True) if n)
    found = f"no pose at {place} in {LISTENS_S:g} s" + (f"; not used: {unused}" if unused else "")
    return Finding(topic, "missing", found, f"start the sender; messages must come from {tracker.sender}")
