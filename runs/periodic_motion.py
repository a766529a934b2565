"""Periods of set-points that repeat, and amplitude, lag, hysteresis and error of the motion in each.

Amplitude and lag are those of the fundamental, fitted by least squares over whole periods. The tip moves along the
first principal axis of its measured positions (without any, of the model's). The loop is the area that tip and measured
pressure enclose over one period (shoelace formula), as a part of the rectangle around it. A tip that goes round, as on
a circle, has neither lag nor loop: its phase to the pressure of one actuator is a direction, not a delay.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runs.archive.reader import ArchiveReader
from runs.arrays import Array
from runs.records import DetectionStatus

NAN = float("nan")
FEWEST_FRAMES = 8
"""Frames in a period without which nothing is computed from it."""
ROUND = 0.3
"""Ratio of the axes of the fundamental's ellipse above which the tip goes round."""
TOLERANCE = 0.02
"""Largest relative deviation of a period from their median."""
_MISSING = 0.01
"""Part of a period that may be missing at the end of whole ones: the time from the last row to the next."""


def last_period(time_s: Array, setpoint_bar: Array) -> tuple[float, float] | None:
    """Return start and end [s] of the last of `period_bounds`; None if the set-points do not repeat."""
    bounds = period_bounds(time_s, setpoint_bar)
    return None if bounds is None else (float(bounds[-2]), float(bounds[-1]))


def whole_periods(time_s: Array, setpoint_bar: Array) -> Array | None:
    """Return the bounds (k + 1,) [s] of as many periods as fit, from the first row on; None if they do not repeat.

    Their length is the mean of those of `period_bounds`, which leaves the parts before and after the crossings out.
    """
    crossings = period_bounds(time_s, setpoint_bar)
    if crossings is None:
        return None
    period_s = float(np.diff(crossings).mean())
    count = int((time_s[-1] - time_s[0]) / period_s + _MISSING)
    return np.asarray(time_s[0] + period_s * np.arange(count + 1))


def period_bounds(time_s: Array, setpoint_bar: Array) -> Array | None:
    """Return the bounds (k + 1,) [s] of the whole periods of set-points (n, actuators); None if they do not repeat.

    A period lies between two upward crossings of the mid-range, interpolated, of the actuator that moves most.
    """
    if len(time_s) < 2 or not np.isfinite(setpoint_bar).all():
        return None
    wave = setpoint_bar[:, np.argmax(np.ptp(setpoint_bar, axis=0))]
    if np.ptp(wave) == 0:
        return None
    above = wave - (wave.max() + wave.min()) / 2
    rising: NDArray[np.intp] = np.flatnonzero((above[:-1] < 0) & (above[1:] >= 0))
    part: NDArray[Any] = above[rising] / (above[rising] - above[rising + 1])
    crossings = time_s[rising] + part * (time_s[rising + 1] - time_s[rising])
    periods = np.diff(crossings)
    if len(periods) == 0 or np.abs(periods / np.median(periods) - 1).max() > TOLERANCE:
        return None
    return np.asarray(crossings)


@dataclass(frozen=True)
class PeriodicMotion:
    """A segment whose set-points repeat; NaN where nothing was measured. Lags count from the set-point.

    Lags and loops of a tip that goes round are NaN.
    """

    label: str
    period_s: float
    pressure_ratio: float
    """Amplitude of the measured pressure over that of the set-point."""
    pressure_lag_ms: float
    tip_amplitude_mm: float
    tip_lag_ms: float
    model_ratio: float
    """Amplitude of the modelled tip over that of the measured tip."""
    model_lag_ms: float
    tip_loop_percent: float
    model_loop_percent: float
    error_mm: tuple[float, ...]
    """Mean distance of measured and modelled tip in each period."""


def periodic_motions(run: ArchiveReader) -> tuple[PeriodicMotion, ...]:
    """Return the periodic segments of a run."""
    found = []
    for interval in run.header.intervals:
        pressure = run.pressure
        rows = slice(*np.searchsorted(pressure.protocol_s, (interval.start_s, interval.stop_s)))
        bounds = whole_periods(pressure.protocol_s[rows], pressure.setpoint_bar[rows])
        if bounds is not None:
            found.append(_motion(run, interval.label or interval.kind, bounds))
    return tuple(found)


def _motion(run: ArchiveReader, label: str, bounds: Array) -> PeriodicMotion:
    tip, pressure = run.tip, run.pressure
    period_s = float(np.diff(bounds).mean())
    rows = slice(*np.searchsorted(pressure.protocol_s, (bounds[0], bounds[-1])))
    time_s, setpoint = pressure.protocol_s[rows], pressure.setpoint_bar[rows]
    actuator = int(np.argmax(np.ptp(setpoint, axis=0)))
    commanded = fundamental(time_s, setpoint[:, actuator], period_s)
    got = fundamental(time_s, pressure.measured_bar[rows, actuator], period_s)

    frames = slice(*np.searchsorted(tip.protocol_s, (bounds[0], bounds[-1])))
    seen = (tip.seen[frames] == DetectionStatus.MEASURED)[:, None]
    measured_mm, model_mm = np.where(seen, tip.measured_mm[frames], NAN), tip.model_mm[frames]
    tip_s, path_mm, axis = tip.protocol_s[frames], measured_mm, _principal_axis(measured_mm)
    if axis is None:
        path_mm, axis = model_mm, _principal_axis(model_mm)
    axis = np.full(3, NAN) if axis is None else axis
    measured, model = measured_mm @ axis, model_mm @ axis
    moved, modelled = (fundamental(tip_s, along, period_s) for along in (measured, model))
    # Not the model's input, which is older than the frame: 2 ms are a loop of 1 % at 1 Hz.
    at_frame = np.interp(tip_s, time_s, pressure.measured_bar[rows, actuator])
    origin = commanded
    if goes_round(tip_s, path_mm, period_s):
        at_frame, origin = np.full_like(at_frame, NAN), complex(NAN, NAN)
    which = np.searchsorted(bounds, tip_s, side="right") - 1
    periods = [which == k for k in range(len(bounds) - 1)]
    error = np.where(seen[:, 0], tip.error_mm[frames], NAN)
    return PeriodicMotion(
        label=label,
        period_s=period_s,
        pressure_ratio=abs(got) / abs(commanded),
        pressure_lag_ms=_lag_ms(commanded, got, period_s),
        tip_amplitude_mm=abs(moved),
        tip_lag_ms=_lag_ms(origin, moved, period_s, either_sign=True),
        model_ratio=abs(modelled) / abs(moved) if abs(moved) > 0 else NAN,
        model_lag_ms=_lag_ms(origin, modelled, period_s, either_sign=True),
        tip_loop_percent=_mean([loop_percent(at_frame[k], measured[k]) for k in periods]),
        model_loop_percent=_mean([loop_percent(at_frame[k], model[k]) for k in periods]),
        error_mm=tuple(_mean(error[k].tolist()) for k in periods),
    )


def fundamental(time_s: Array, values: Array, period_s: float) -> complex:
    """Return the complex amplitude c of `Re(c exp(i w t))` plus a constant, fitted to values (n,) that may have NaN."""
    known = np.isfinite(values)
    if known.sum() < FEWEST_FRAMES:
        return complex(NAN, NAN)
    angle = 2 * math.pi * time_s[known] / period_s
    design = np.column_stack((np.ones(len(angle)), np.cos(angle), -np.sin(angle)))
    _, cosine, sine = np.linalg.lstsq(design, values[known], rcond=None)[0]
    return complex(cosine, sine)


def goes_round(time_s: Array, points_mm: Array, period_s: float) -> bool:
    """Whether the fundamental of points (n, 3) is an ellipse rather than a line."""
    waves = np.array([fundamental(time_s, column, period_s) for column in points_mm.T])
    if not np.isfinite(waves).all():
        return False
    longest, shortest = np.linalg.svd(np.stack([waves.real, waves.imag]), compute_uv=False)
    return bool(shortest > ROUND * longest)


def loop_percent(across: Array, along: Array) -> float:
    """Return the area of the closed loop through points (n,), as a part of the rectangle around them [%]."""
    known = np.isfinite(across) & np.isfinite(along)
    x, y = across[known], along[known]
    if len(x) < FEWEST_FRAMES or (rectangle := float(np.ptp(x) * np.ptp(y))) == 0:
        return NAN
    area = 0.5 * abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))))
    return 100 * area / rectangle


def _lag_ms(reference: complex, response: complex, period_s: float, *, either_sign: bool = False) -> float:
    """Return by how much a response lags, at most half a period; `either_sign`: a quarter, whatever its direction."""
    if not (np.isfinite(reference) and np.isfinite(response)) or abs(response) == 0:
        return NAN
    ratio = reference / response
    if either_sign and ratio.real < 0:
        ratio = -ratio
    return 1e3 * period_s * math.atan2(ratio.imag, ratio.real) / (2 * math.pi)


def _principal_axis(points_mm: Array) -> Array | None:
    known = points_mm[np.isfinite(points_mm).all(axis=1)]
    if len(known) < FEWEST_FRAMES:
        return None
    _, _, axes = np.linalg.svd(known - known.mean(axis=0), full_matrices=False)
    return np.asarray(axes[0])


def _mean(values: list[float]) -> float:
    known = [value for value in values if math.isfinite(value)]
    return sum(known) / len(known) if known else NAN
