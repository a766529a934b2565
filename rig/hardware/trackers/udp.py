"""The UDP tracker: poses that another program sends in datagrams."""

from __future__ import annotations

import contextlib
import socket
import time

from rig.config.drivers import Finding
from rig.config.schema import RigConfig
from rig.config.tracker_sections import UdpTrackerConfig
from rig.hardware.trackers.base import TrackerError, TrackerReading
from rig.hardware.trackers.datagram import BYTES
from rig.hardware.trackers.receiver import TrackerReceiver
from runs.records import DATAGRAM_COUNTS

_SO_TIMESTAMPNS = getattr(socket, "SO_TIMESTAMPNS", 35)
"""Linux: the kernel's time of arrival comes with the message. Python names the option since 3.14 only."""
_TIMESPEC = 16
_BUFFER = 1 << 18
LISTENS_S = 1.5
"""Time in which a sender's clock becomes known and a pose comes."""


class UdpTracker:
    """A socket that receives the datagrams of one sender."""

    def __init__(self, config: RigConfig, name: str, seed: int = 0) -> None:
        """Listen for a tracker of the rig; nothing is random, whatever the `seed`.

        Raises:
            TrackerError: the address is not this machine's, or the port is taken.
        """
        section = config.trackers[name]
        assert isinstance(section, UdpTrackerConfig)
        self._receiver = TrackerReceiver(config, name, (section.sender, section.sender_port))
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            with contextlib.suppress(OSError):
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
            with contextlib.suppress(OSError):
                self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
            self._socket.bind((section.address, section.port))
        except OSError as error:
            self._socket.close()
            place = f"{section.address}:{section.port}"
            raise TrackerError(
                f"tracker {name} cannot listen at UDP {place}: {error.strerror}; "
                "is the address this machine's, and does another program use the port?"
            ) from error

    def read(self, timeout_s: float) -> TrackerReading | None:
        """Wait for the next reading; None without one within the time-out.

        A late reader also gets what has arrived by then, behind messages that give no reading.
        """
        until_ns = time.monotonic_ns() + round(timeout_s * 1e9)
        while True:
            self._socket.settimeout(max((until_ns - time.monotonic_ns()) * 1e-9, 1e-6))
            try:
                data, ancillary, _, sender = self._socket.recvmsg(BYTES + 1, 64)
            except TimeoutError:
                return None
            except OSError as error:
                raise TrackerError(f"the socket of the tracker failed: {error}") from error
            arrived_ns = _arrival_ns(ancillary)
            reading = self._receiver.receive(data, sender, arrived_ns)
            if reading is not None or arrived_ns > until_ns:
                return reading

    def counts(self) -> tuple[int, ...]:
        return self._receiver.counts

    def pass_over(self, t_ns: int) -> None:
        self._receiver.pass_over(t_ns)

    def close(self) -> None:
        self._socket.close()


def _arrival_ns(ancillary: list[tuple[int, int, bytes]]) -> int:
    """Time of arrival on CLOCK_MONOTONIC: the kernel's, which is on CLOCK_REALTIME, else the time of reading.

    CLOCK_MONOTONIC is read last: if this process is stopped between the two clocks, the time is too late, which the
    estimate of the sender's clock bears as a long delay. A time that is too early would shift it.
    """
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS and len(data) >= _TIMESPEC:
            seconds, nanoseconds = (int.from_bytes(data[i : i + 8], "little", signed=True) for i in (0, 8))
            age_ns = time.time_ns() - (seconds * 1_000_000_000 + nanoseconds)
            # CLOCK_REALTIME may be set between arrival and reading.
            return time.monotonic_ns() - (age_ns if 0 <= age_ns < 1_000_000_000 else 0)
    return time.monotonic_ns()


def examine(config: RigConfig, name: str) -> list[Finding]:
    """Listen for poses, for `rig doctor`; none come while a run uses the port."""
    section = config.trackers[name]
    assert isinstance(section, UdpTrackerConfig)
    topic, place = f"rig's tracker {name}", f"UDP {section.address}:{section.port}"
    try:
        with contextlib.closing(UdpTracker(config, name)) as tracker:
            reading = tracker.read(LISTENS_S)
            counts = tracker.counts()
    except TrackerError as error:
        return [Finding(topic, "missing", str(error), "end the other program, or state another port")]
    if reading is not None:
        found = (
            f"poses at {place} from {section.sender}; its clock drifts by {reading.clock.drift * 1e6:+.0f} ppm, "
            f"times are known to {reading.time_std_s * 1e3:.2f} ms beside the constant delay"
        )
        return [Finding(topic, "ok", found, "nothing")]
    unused = ", ".join(f"{n} {what.replace('_', ' ')}" for what, n in zip(DATAGRAM_COUNTS, counts, strict=True) if n)
    found = f"no pose at {place} in {LISTENS_S:g} s" + (f"; not used: {unused}" if unused else "")
    return [Finding(topic, "missing", found, f"start the sender; messages must come from {section.sender}")]
