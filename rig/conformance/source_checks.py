"""What softrig relies on in a driver of a device that sends by itself: a camera or a tracker."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass

import numpy as np

from rig.config.schema import RigConfig
from rig.conformance.check import Check, NonconformityError
from rig.hardware.cameras.base import Frame, open_camera
from rig.hardware.trackers.base import TrackerReading, open_tracker
from rig.hardware.trackers.datagram import LARGEST_STD

LATEST_S = 2.0
"""A time that is older than this at its arrival is on another clock."""
FRAMES, READINGS = 15, 50
TIMEOUT_S = 2.0
READS_AT_ONCE = 15
FIRST_S, NEXT_S = 5.0, 1.0
_TOLERANCE = 1e-6


@dataclass(frozen=True)
class SourceSubject:
    """A camera or tracker under test."""

    config: RigConfig
    name: str


def _frames(subject: SourceSubject, count: int = FRAMES) -> list[tuple[Frame, int]]:
    """Some frames of a camera with the times of their arrival [ns]."""
    with closing(open_camera(subject.config.free_running, subject.name)) as camera:
        return [(camera.read(TIMEOUT_S), time.monotonic_ns()) for _ in range(count)]


def _readings(subject: SourceSubject, count: int = READINGS) -> list[tuple[TrackerReading, int]]:
    """Some readings of a tracker with the times of their arrival [ns]."""
    found = []
    with closing(open_tracker(subject.config, subject.name)) as tracker:
        for timeout_s in (FIRST_S, *[NEXT_S] * (count - 1)):
            reading = tracker.read(timeout_s)
            if reading is None:
                raise NonconformityError(f"no reading within {timeout_s:g} s")
            found.append((reading, time.monotonic_ns()))
    return found


def pictures(subject: SourceSubject) -> str:
    """Pictures have the size of the rig file."""
    camera = subject.config.cameras[subject.name]
    frames = [frame for frame, _ in _frames(subject)]
    for frame in frames:
        shape = frame.image.shape
        if frame.image.dtype != np.uint8 or shape[:2] != (camera.height_px, camera.width_px):
            raise NonconformityError(f"a picture has the shape {shape} and the type {frame.image.dtype}")
        if shape[2:] not in ((), (3,)):
            raise NonconformityError(f"a picture has {shape[2]} channels; grey or BGR is expected")
    return f"{len(frames)} pictures of {shape[1]} x {shape[0]}, {'BGR' if shape[2:] else 'grey'}"


def stamps(subject: SourceSubject) -> str:
    """Every picture is new, with a time of CLOCK_MONOTONIC."""
    frames = _frames(subject)
    measured = _rate_and_age(frames, "pictures", subject.config.cameras[subject.name].rate_hz)
    dropped = frames[-1][0].index - frames[0][0].index - (len(frames) - 1)
    return f"{measured}, {dropped} dropped"


def camera_reopening(subject: SourceSubject) -> str:
    """A camera can be opened again once it is closed."""
    opened = _opened_twice(lambda: _frames(subject, 1))
    return f"{opened}, serial number {subject.config.cameras[subject.name].serial() or 'none'}"


def poses(subject: SourceSubject) -> str:
    """A pose is a position, a rotation and a covariance that is positive definite."""
    readings = [reading for reading, _ in _readings(subject)]
    seen = [reading for reading in readings if reading.seen]
    for reading in seen:
        if reading.position_m.shape != (3,) or not np.isfinite(reading.position_m).all():
            raise NonconformityError(f"a position is {reading.position_m}")
        if not np.allclose(reading.rotation @ reading.rotation.T, np.eye(3), atol=_TOLERANCE):
            raise NonconformityError("a rotation is not orthogonal")
        if reading.covariance.shape != (6, 6) or np.linalg.eigvalsh(reading.covariance)[0] <= 0:
            raise NonconformityError("a covariance is not positive definite")
        if not np.diag(reading.covariance).max() <= LARGEST_STD**2:
            raise NonconformityError(f"a standard deviation is above {LARGEST_STD:g} m or rad")
    std_mm = [np.sqrt(np.trace(reading.covariance[:3, :3])) * 1e3 for reading in seen]
    return f"{len(seen)} of {len(readings)} readings have a pose" + (f", to {np.median(std_mm):.2f} mm" if seen else "")


def times(subject: SourceSubject) -> str:
    """Readings are in order of time on CLOCK_MONOTONIC, at the stated rate."""
    readings = _readings(subject)
    # A time may be ahead of its arrival by its uncertainty.
    early_s = 3 * max(reading.time_std_s for reading, _ in readings)
    return _rate_and_age(readings, "readings", subject.config.trackers[subject.name].rate_hz, early_s)


def time_outs(subject: SourceSubject) -> str:
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
        raise NonconformityError(f"a read with a time-out of 0 takes {typical_s * 1e3:.1f} ms: it waits for a reading")
    return f"a read with a time-out of 0 takes {typical_s * 1e3:.2f} ms"


def tracker_reopening(subject: SourceSubject) -> str:
    """A closed tracker can be opened again."""
    return _opened_twice(lambda: _readings(subject, 1))


def _opened_twice(read_one: Callable[[], object]) -> str:
    began = time.monotonic()
    for _ in range(2):
        read_one()
    return f"opened twice in {time.monotonic() - began:.1f} s"


def _rate_and_age(
    items: Sequence[tuple[Frame | TrackerReading, int]], kind: str, stated_hz: float, early_s: float = 0.0
) -> str:
    """Check times and numbers of items, each with the time of its arrival [ns], and return rate and age as text.

    early_s: how far ahead of its arrival a time may be.

    Raises:
        NonconformityError: times or numbers do not increase, are on another clock, or the rate is not the stated one.
    """
    t_ns = np.array([item.t_ns for item, _ in items])
    index = np.array([item.index for item, _ in items])
    age_s = np.array([arrived - item.t_ns for item, arrived in items]) * 1e-9
    if np.any(np.diff(t_ns) <= 0) or np.any(np.diff(index) <= 0):
        raise NonconformityError(f"times or numbers of the {kind} do not increase")
    if age_s.min() < -early_s or age_s.max() > LATEST_S:
        raise NonconformityError(f"{kind} are {age_s.min():.3f} to {age_s.max():.3f} s old at their arrival")
    rate = (index[-1] - index[0]) / ((t_ns[-1] - t_ns[0]) * 1e-9)
    if not 0.8 * stated_hz <= rate <= 1.25 * stated_hz:
        raise NonconformityError(f"{rate:.1f} {kind}/s; the rig file says {stated_hz:g}")
    return f"{rate:.1f} {kind}/s, {np.median(age_s) * 1e3:.0f} ms old at arrival"


CAMERA_CHECKS: tuple[Check[SourceSubject], ...] = (
    Check("pictures", "uint8, grey or BGR, in the size of the rig file", pictures),
    Check("stamps", "the middle of the exposure on CLOCK_MONOTONIC, increasing, at rate_hz", stamps),
    Check("reopening", "a closed camera can be opened again", camera_reopening),
)
TRACKER_CHECKS: tuple[Check[SourceSubject], ...] = (
    Check("poses", "position, rotation and positive definite covariance of the tip", poses),
    Check("times", "CLOCK_MONOTONIC, increasing, at rate_hz", times),
    Check("time-outs", "read waits no longer than its time-out", time_outs),
    Check("reopening", "a closed tracker can be opened again", tracker_reopening),
)
