"""The tracker interface, and how a tracker of a rig is opened."""

from __future__ import annotations

from dataclasses import dataclass
from ipaddress import IPv4Address
from typing import Protocol

from model.arrays import Array
from rig.config.schema import RigConfig
from rig.hardware.driver_calls import TipSourceError
from runs.records import DATAGRAM_COUNTS


class TrackerError(TipSourceError):
    """The tracker could not be opened or has fallen silent; the message contains the remedy."""


@dataclass(frozen=True)
class ClockEstimate:
    """Our clock (CLOCK_MONOTONIC) as a function of the sender's, at one time.

    `offset_s` is our time minus the sender's; `drift` its change per second of the sender; `std_s` the standard
    uncertainty of a converted time, without that of the constant part of the delay.
    """

    offset_s: float
    drift: float
    std_s: float


@dataclass(frozen=True)
class TrackerReading:
    """One message of a tracker, on our clock.

    `index` counts messages of the sender, so that a gap is a lost one. `position_m` (3,), `rotation` (3, 3) and
    `covariance` (6, 6) [m, rad] are the tip in the rod-base frame, all NaN where the tracker saw nothing (`seen`).
    `counts` are those of `DATAGRAM_COUNTS` since the tracker was opened; `foreign_ipv4` is the address of the last
    foreign sender as one number, 0 without one. `time_std_s` contains all that is uncertain about `t_ns`. `truth_m` is
    the simulator's tip, None for a real tracker.
    """

    index: int
    t_ns: int
    seen: bool
    position_m: Array
    rotation: Array
    covariance: Array
    clock: ClockEstimate
    time_std_s: float
    counts: tuple[int, ...] = (0,) * len(DATAGRAM_COUNTS)
    foreign_ipv4: int = 0
    truth_m: Array | None = None


class Tracker(Protocol):
    """An open tracker."""

    def read(self, timeout_s: float) -> TrackerReading | None:
        """Wait for the next reading, in increasing order of time; None without one within the time-out.

        Raises:
            TrackerError: the tracker has failed.
        """

    def pass_over(self, t_ns: int) -> None:
        """State that a time has been given as one without a measurement: readings of earlier poses are late."""

    def counts(self) -> tuple[int, ...]:
        """`DATAGRAM_COUNTS` since the tracker was opened."""

    def close(self) -> None:
        """Release the device."""


def other_sender(ipv4: int) -> str:
    """What there is to say of a foreign sender, by its address."""
    return (
        f"another program, at {IPv4Address(ipv4)}, sends poses to the tracker's port: "
        "end it, or state the tracker's `sender` and `sender_port` in the rig file"
    )


def open_tracker(config: RigConfig, name: str, seed: int = 0) -> Tracker:
    """Open the rig's tracker `name`; `seed` is for simulated trackers. Raises TrackerError."""
    tracker: Tracker = config.trackers[name].driven_by.load()(config, name, seed)
    return tracker
