"""Error of the tip on its paths: measured, and for a simulated run true, minus reference.

The error is split into three parts. *Lag*: the share along the path that a delay explains, the delay that fits best
(least squares) times the reference's speed. *Contour*: across the path. *Noise*: what changes from frame to frame, by
second differences of three frames without a gap, which a smooth error does not have (median absolute deviation).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from runs.archive.reader import ArchiveReader
from runs.arrays import Array

NAN = float("nan")
LEAST_FRAMES = 5
"""Frames from which the error is split into its parts."""
MOVING_MM_S = 0.1
MEDIAN_OF_NORMAL = 0.6745
"""Median amount of a standard normal variable."""


@dataclass(frozen=True)
class TipError:
    """Root mean squares [mm] over the frames on a path, without its lead-in; NaN without data.

    With fewer than LEAST_FRAMES frames the parts are NaN.
    """

    frames: int = 0
    """Those on a path at which the tip is known."""
    rms_mm: float = NAN
    max_mm: float = NAN
    lag_ms: float = NAN
    """Delay of the tip behind its reference; negative where it is ahead."""
    lag_mm: float = NAN
    contour_mm: float = NAN
    noise_mm: float = NAN
    periods_mm: tuple[float, ...] = ()
    """Of each period, in order."""


@dataclass(frozen=True)
class TipErrorSummary:
    """The tip paths of a run."""

    measured: TipError
    truth: TipError | None
    """Against the simulator's tip; None for a run without one."""
    predicted_mm: float
    """Root mean square of the model's error under the feed-forward set-points, computed before the run."""


def tip_error(run: ArchiveReader) -> TipErrorSummary | None:
    """Return the errors on the tip paths of a run; None for a run without one."""
    reference = run.reference
    if reference is None:
        return None
    target = reference.reference_mm
    # A coordinate that is not controlled has no error.
    free = np.isnan(target)
    velocity = _velocity(run.tip.time_s, target, reference.motion)
    path = reference.period > 0

    def split(tip_mm: Array) -> TipError:
        off = np.where(free, 0.0, tip_mm - np.where(free, 0.0, target))
        known = path & np.isfinite(tip_mm).all(axis=1)
        whole = _whole(off, known, reference.motion, reference.period)
        if whole.frames < LEAST_FRAMES:
            return whole
        return _with_parts(whole, off[known], velocity[known], run.tip.frame[known])

    predicted = np.where(free, 0.0, reference.predicted_mm - np.where(free, 0.0, target))[path]
    truth = None if run.simulated is None else split(run.simulated.tip_mm)
    return TipErrorSummary(split(run.tip.measured_mm), truth, _rms(predicted))


def _velocity(time_s: Array, target_mm: Array, motion: NDArray[np.int64]) -> Array:
    """Velocities (m, 3) [mm/s] of the reference; zero where it has none."""
    velocity = np.zeros_like(target_mm)
    for number in range(1, int(motion.max(initial=0)) + 1):
        rows = np.flatnonzero(motion == number)
        if len(rows) > 2:
            velocity[rows] = np.nan_to_num(np.gradient(target_mm[rows], time_s[rows], axis=0))
    return velocity


def _whole(off_mm: Array, path: NDArray[np.bool_], motion: NDArray[np.int64], period: NDArray[np.int64]) -> TipError:
    """The errors over the whole path and over each of its periods."""
    frames = int(path.sum())
    if not frames:
        return TipError()
    off = off_mm[path]
    passes = sorted({(int(m), int(p)) for m, p in zip(motion[path], period[path], strict=True)})
    return TipError(
        frames=frames,
        rms_mm=_rms(off),
        max_mm=float(np.linalg.norm(off, axis=1).max()),
        periods_mm=tuple(_rms(off_mm[path & (motion == m) & (period == p)]) for m, p in passes),
    )


def _with_parts(whole: TipError, off: Array, rate: Array, frame: NDArray[np.int64]) -> TipError:
    """The error with its lag, contour and noise, of errors [mm] and reference velocities [mm/s] (n, 3) of frames."""
    speed = np.linalg.norm(rate, axis=1)
    moving = speed > MOVING_MM_S
    squares = float((speed[moving] ** 2).sum())
    lag_s = -float((off[moving] * rate[moving]).sum()) / squares if squares else NAN
    along = np.zeros(len(off))
    along[moving] = (off[moving] * rate[moving]).sum(axis=1) / speed[moving]
    across = np.sqrt(np.maximum((off**2).sum(axis=1) - along**2, 0.0))
    changes = (off[2:] - 2 * off[1:-1] + off[:-2])[frame[2:] - frame[:-2] == 2]
    return replace(
        whole,
        lag_ms=1e3 * lag_s,
        lag_mm=abs(lag_s) * float(np.sqrt(np.mean(speed**2))) if squares else 0.0,
        contour_mm=float(np.sqrt(np.mean(across**2))),
        noise_mm=_noise(changes),
    )


def _noise(changes: Array) -> float:
    """Root mean square of the length of white noise with second differences (n, 3) in three coordinates.

    White noise of variance s^2 gives second differences of variance 6 s^2. Each s comes from the median of their
    amounts, which a tip that swings at some corners hardly changes.
    """
    if not len(changes):
        return NAN
    std = np.median(np.abs(changes), axis=0) / (MEDIAN_OF_NORMAL * math.sqrt(6.0))
    return float(np.linalg.norm(std))


def _rms(rows: Array) -> float:
    """Root mean square of the lengths of rows (n, 3)."""
    return float(np.sqrt(np.mean((rows**2).sum(axis=1)))) if len(rows) else NAN
