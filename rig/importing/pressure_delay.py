"""By how much pressures lead the tip, from the table itself."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Largest delay that is looked for, at most this share of the table, and the smallest step of the rows compared.
_LONGEST_S, _PART, _STEP_S = 2.0, 0.125, 0.02
# Changes are taken over this time, so that noise counts little.
_CHANGE_S = 0.1
# Blocks of rows of the jackknife, and Student's factor for so many.
_BLOCKS, _STUDENT = 10, 1.13
# The changes of the pressures explain at least this share of those of the tip, or there is no delay to state.
_LEAST_SHARE = 0.3
# A larger standard uncertainty is no measurement of a delay.
_MOST_STD_S = 0.1


@dataclass(frozen=True)
class PressureDelay:
    """Time by which the pressures lead the tip, and the share of the tip's motion that so delayed pressures explain."""

    delay_s: float
    std_s: float
    share: float


def measured_delay(time_s: Floats, pressure_pa: Floats, tip_m: Floats) -> PressureDelay | None:
    """The delay (n,) at which changes of the pressures (n, N) explain those of the tip (n, 3) best, linearly.

    The standard uncertainty is that of a jackknife over blocks of rows. None if the delay cannot be determined.
    """
    period_s = max(float(np.median(np.diff(time_s))), _STEP_S) if len(time_s) > 1 else math.inf
    if not math.isfinite(period_s):
        return None
    grid_s = np.arange(time_s[0], time_s[-1], period_s)
    lags = min(round(_LONGEST_S / period_s), round(_PART * len(grid_s)))
    if lags < 2:
        return None
    nearest = np.clip(np.searchsorted(time_s, grid_s), 1, len(time_s) - 1)
    known = np.asarray(np.isfinite(tip_m).all(axis=1) & np.isfinite(pressure_pa).all(axis=1))
    if known.sum() < _BLOCKS:
        return None
    seen = known[nearest] & known[nearest - 1]
    pressure, tip = (
        np.column_stack([np.interp(grid_s, time_s[known], column) for column in values[known].T])
        for values in (pressure_pa, tip_m)
    )
    width = max(1, round(_CHANGE_S / period_s))
    by, of = pressure[width:] - pressure[:-width], tip[width:] - tip[:-width]
    own, cross, motion = _moments(by, of, seen[width:] & seen[:-width], lags)
    total = float(motion.sum())
    if total <= 0:
        return None
    shares = _shares(own.sum(axis=1), cross.sum(axis=1), total)
    best = _summit(shares)
    if best is None or shares.max() < _LEAST_SHARE:
        return None
    without = []
    for block in range(_BLOCKS):
        rest = [k for k in range(_BLOCKS) if k != block]
        left = float(motion[rest].sum())
        some = _shares(own[:, rest].sum(axis=1), cross[:, rest].sum(axis=1), left) if left > 0 else np.zeros(1)
        summit = _summit(some)
        if summit is None:
            return None
        without.append(summit)
    deviation = np.array(without) - np.mean(without)
    std = _STUDENT * math.sqrt((_BLOCKS - 1) / _BLOCKS * float(deviation @ deviation))
    # A row says no more of the time than its period.
    std_s = math.hypot(std * period_s, period_s / math.sqrt(12))
    if std_s > _MOST_STD_S:
        return None
    return PressureDelay((best - lags) * period_s, std_s, float(shares.max()))


def _moments(by: Floats, of: Floats, seen: NDArray[np.bool_], lags: int) -> tuple[Floats, Floats, Floats]:
    """Second moments of the seen rows by lag and block: (L, B, N, N) of `by`, (L, B, N, 3) of both, (B,) of `of`."""
    middle = slice(lags, len(of) - lags)
    edges = np.linspace(0, len(of[middle]), _BLOCKS + 1).round().astype(int)
    blocks = [slice(a, b) for a, b in pairwise(edges.tolist())]
    counts = seen[middle, None]
    followed = of[middle] * counts
    own, cross = [], []
    for lag in range(2 * lags + 1):
        # A lag of `lags` rows is no delay.
        start = 2 * lags - lag
        led = by[start : start + len(followed)] * counts
        own.append([led[block].T @ led[block] for block in blocks])
        cross.append([led[block].T @ followed[block] for block in blocks])
    return np.array(own), np.array(cross), np.array([float((followed[block] ** 2).sum()) for block in blocks])


def _shares(own: Floats, cross: Floats, total: float) -> Floats:
    """Share (L,) of the tip's changes that a linear response explains at each lag."""
    slope = np.linalg.pinv(own, rcond=1e-9, hermitian=True) @ cross
    out: Floats = (slope * cross).sum(axis=(1, 2)) / total
    return out


def _summit(shares: Floats) -> float | None:
    """The lag with the largest share, between rows by a parabola; None at an end."""
    top = int(np.argmax(shares))
    if not 0 < top < len(shares) - 1:
        return None
    before, at, after = shares[top - 1 : top + 2]
    bend = before - 2 * at + after
    return top if bend >= 0 else top + 0.5 * float((before - after) / bend)
