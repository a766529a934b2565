"""What softrig relies on in a tracker driver."""

from __future__ import annotations

import time
from contextlib import closing
from dataclasses import dataclass

import numpy as np

from rig.config.schema import RigConfig
from rig.driver_contract.check import BrokenContractError, Check
from rig.driver_contract.time_stamps import rate_and_age
from rig.hardware.trackers.base import TrackerReading
from rig.hardware.trackers.datagram import LARGEST_STD
from rig.hardware.trackers.opening import open_tracker

READINGS = 50
READS_AT_ONCE = 15
FIRST_S, NEXT_S = 5.0, 1.0
_TOLERANCE = 1e-6


@dataclass(frozen=True)
class TrackerSubject:
    """A tracker under test."""

    config: RigConfig
    name: str

    def readings(self) -> list[tuple[TrackerReading, int]]:
        """Some readings with the times of their arrival [ns]."""
        found = []
        with closing(open_tracker(self.config, self.name)) as tracker:
            for k in range(READINGS):
                reading = tracker.read(FIRST_S if k == 0 else NEXT_S)
                if reading is None:
                    raise BrokenContractError(f"no reading within {FIRST_S if k == 0 else NEXT_S:g} s")
                found.append((reading, time.monotonic_ns()))
        return found


def poses(subject: TrackerSubject) -> str:
    """A pose is a position, a rotation and a covariance that is positive definite."""
    readings = [reading for reading, _ in subject.readings()]
    seen = [reading for reading in readings if reading.seen]
    for reading in seen:
        if reading.position_m.shape != (3,) or not np.isfinite(reading.position_m).all():
            raise BrokenContractError(f"a position is {reading.position_m}")
        if not np.allclose(reading.rotation @ reading.rotation.T, np.eye(3), atol=_TOLERANCE):
            raise BrokenContractError("a rotation is not orthogonal")
        if reading.covariance.shape != (6, 6) or np.linalg.eigvalsh(reading.covariance)[0] <= 0:
            raise BrokenContractError("a covariance is not positive definite")
        if not np.diag(reading.covariance).max() <= LARGEST_STD**2:
            raise BrokenContractError(f"a standard deviation is above {LARGEST_STD:g} m or rad")
    std_mm = [np.sqrt(np.trace(reading.covariance[:3, :3])) * 1e3 for reading in seen]
    return f"{len(seen)} of {len(readings)} readings have a pose" + (f", to {np.median(std_mm):.2f} mm" if seen else "")


def times(subject: TrackerSubject) -> str:
    """Readings are in order of time on CLOCK_MONOTONIC, at the stated rate."""
    readings = subject.readings()
    # A time may be ahead of its arrival by its uncertainty.
    early_s = 3 * max(reading.time_std_s for reading, _ in readings)
    return rate_and_age(readings, "readings", subject.config.trackers[subject.name].rate_hz, early_s)


def time_outs(subject: TrackerSubject) -> str:
    """A read with a time-out of 0 returns at once, with a reading that has arrived or None."""
    period_s = 1 / subject.config.trackers[subject.name].rate_hz
    with closing(open_tracker(subject.config, subject.name)) as tracker:
        tracker.read(FIRST_S)
        took_s = []
        for _ in range(READS_AT_ONCE):
            began = time.monotonic()
            tracker.read(0.0)
            took_s.append(time.monotonic() - began)
    typical_s = float(np.median(took_s))
    if typical_s > period_s / 2:
        raise BrokenContractError(f"a read with a time-out of 0 takes {typical_s * 1e3:.1f} ms: it waits for a reading")
    return f"a read with a time-out of 0 takes {typical_s * 1e3:.2f} ms"


def reopening(subject: TrackerSubject) -> str:
    """A closed tracker can be opened again."""
    began = time.monotonic()
    for _ in range(2):
        with closing(open_tracker(subject.config, subject.name)) as tracker:
            if tracker.read(FIRST_S) is None:
                raise BrokenContractError(f"no reading within {FIRST_S:g} s of opening")
    return f"opened twice in {time.monotonic() - began:.1f} s"


TRACKER_CHECKS: tuple[Check[TrackerSubject], ...] = (
    Check("poses", "position, rotation and positive definite covariance of the tip", poses),
    Check("times", "CLOCK_MONOTONIC, increasing, at rate_hz", times),
    Check("time-outs", "read waits no longer than its time-out", time_outs),
    Check("reopening", "a closed tracker can be opened again", reopening),
)
