"""Pressures and set-points of a foreign table, as gauge pressures [Pa], and by how much they lead the tip."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from model.arrays import Array
from model.units import PA_PER_BAR
from protocols.source_positions import Document
from rig.importing.mapping import Mapping
from rig.importing.tables import ColumnReader
from rig.importing.units import PASCALS, PressureUnit
from rig.valves.iso6358 import ATMOSPHERE_PA
from runs.interpolation import interpolated

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


def measured_delay(time_s: Array, pressure_pa: Array, tip_m: Array) -> PressureDelay | None:
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


def _moments(by: Array, of: Array, seen: NDArray[np.bool_], lags: int) -> tuple[Array, Array, Array]:
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


def _shares(own: Array, cross: Array, total: float) -> Array:
    """Share (L,) of the tip's changes that a linear response explains at each lag."""
    slope = np.linalg.pinv(own, rcond=1e-9, hermitian=True) @ cross
    out: Array = (slope * cross).sum(axis=(1, 2)) / total
    return out


def _summit(shares: Array) -> float | None:
    """The lag with the largest share, between rows by a parabola; None at an end."""
    top = int(np.argmax(shares))
    if not 0 < top < len(shares) - 1:
        return None
    before, at, after = shares[top - 1 : top + 2]
    bend = before - 2 * at + after
    return top if bend >= 0 else top + 0.5 * float((before - after) / bend)


VENTED_BAR = 0.02
"""Largest variation of a vented chamber's pressure in the rows that define the ambient pressure."""
AMBIENT_BAR = (0.5, 1.1)
"""Plausible ambient pressures."""
NOISE_PA = 5e3
"""Tolerance for sensor noise below the lowest pressure."""
NOTABLE_DELAY_S = 0.06
"""A delay beside the stated one that is worth a warning."""

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class AppliedDelay:
    """Time by which the pressures lead the tip, its standard uncertainty (NaN: stated without one) and its source."""

    delay_s: float
    std_s: float
    source: str


def pressure_delay(
    columns: ColumnReader, mapping: Mapping, document: Document, time_s: Array, gauge_pa: Array, tip_m: Array
) -> AppliedDelay:
    """The delay that the mapping states or asks to measure; a stated one that the table contradicts is a warning."""
    stated = mapping.pressures.delay_s
    by_mapping = AppliedDelay(0.0 if stated == "measured" else stated, math.nan, f"mapping {Path(document.file).name}")
    if columns.problems:
        return by_mapping
    found = measured_delay(time_s, gauge_pa, tip_m)
    if stated == "measured":
        if found is None:
            expected = "a delay in seconds: the table does not show by how much the tip follows the pressures"
            columns.problems.append(document.problem(("pressures", "delay_s"), expected))
            return by_mapping
        return AppliedDelay(found.delay_s, found.std_s, f"changes of pressures and tip, {found.share:.0%} explained")
    if found is not None and abs(found.delay_s - stated) > max(NOTABLE_DELAY_S, 3 * found.std_s):
        columns.warn(
            f"the tip follows the pressures by {found.delay_s:.2f} +- {found.std_s:.2f} s, the mapping says {stated:g} "
            "s: for quasi-static identification state pressures: delay_s: measured"
        )
    return by_mapping


def delayed(t_ns: Ints, gauge_pa: Array, delay_s: float) -> Array:
    """Pressures (n, N) of `delay_s` earlier, interpolated linearly; before the first row, those of it."""
    if not delay_s:
        return gauge_pa
    time_s = (t_ns - t_ns[0]) * 1e-9
    return interpolated(time_s - delay_s, time_s, gauge_pa)


def pressures(columns: ColumnReader, mapping: Mapping) -> tuple[Array, Array]:
    """Return gauge pressures (n, N) and the subtracted ambient pressures (N,) [Pa]."""
    stated = mapping.pressures
    raw_pa = _scaled(columns, stated.columns, stated.unit)
    for column, values in zip(stated.columns, raw_pa.T, strict=True):
        columns.warn_missing(values, f"the pressure of column {column}")
        lowest_pa = -NOISE_PA if stated.reading == "absolute" else -ATMOSPHERE_PA - NOISE_PA
        if len(rows := np.flatnonzero(values < lowest_pa)):
            found = f"{values[rows[0]] / PA_PER_BAR:.4g} bar, {stated.reading}"
            expected = f"a pressure above vacuum, {lowest_pa / PA_PER_BAR:.3g} bar or more: are unit and reading right?"
            where = f"column {column}, {columns.table.place(int(rows[0]))}"
            columns.refuse(found, expected, where)
    off_pa = np.zeros(mapping.actuators)
    if columns.problems:
        return raw_pa, off_pa
    if stated.reading == "gauge":
        for column, values in zip(stated.columns, raw_pa.T, strict=True):
            if np.nanmin(values, initial=np.inf) / PA_PER_BAR > AMBIENT_BAR[0]:
                lowest = f"{np.nanmin(values) / PA_PER_BAR:.3g} bar"
                columns.warn(f"column {column} never falls below {lowest}: is it absolute? The mapping says gauge")
        return raw_pa, off_pa
    if stated.ambient_bar is not None:
        off_pa[:] = np.array(stated.ambient_bar) * PA_PER_BAR
    elif stated.ambient_rows is not None:
        off_pa = _vented(columns, mapping, raw_pa, stated.ambient_rows)
    for column, ambient in zip(stated.columns, off_pa / PA_PER_BAR, strict=True):
        if not AMBIENT_BAR[0] <= ambient <= AMBIENT_BAR[1]:
            columns.warn(
                f"the ambient pressure subtracted from column {column} is {ambient:.4g} bar: is it really absolute?"
            )
    return raw_pa - off_pa, off_pa


def _vented(columns: ColumnReader, mapping: Mapping, raw_pa: Array, rows: int) -> Array:
    """Each column's mean (N,) [Pa] over the first rows."""
    first = raw_pa[:rows]
    if len(first) < rows:
        expected = f"at least the {rows} rows that ambient_rows names"
        columns.refuse(f"{len(first)} rows", expected)
        return np.zeros(mapping.actuators)
    known = np.isfinite(first)
    means = np.zeros(mapping.actuators)
    for n, column in enumerate(mapping.pressures.columns):
        if not known[:, n].any():
            expected = f"a pressure in the first {rows} rows, for the ambient pressure"
            columns.problems.append(columns.table.problem(0, column, "nothing", expected))
            continue
        values = first[known[:, n], n]
        means[n] = values.mean()
        if (spread := float(np.ptp(values)) / PA_PER_BAR) > VENTED_BAR:
            columns.warn(
                f"column {column} moves by {spread:.3g} bar within the first {rows} rows, whose mean is used as the "
                "ambient pressure"
            )
    return means


def setpoints(columns: ColumnReader, mapping: Mapping) -> Array:
    """Set-points (n, N) [Pa], or NaN where the file has none."""
    if mapping.setpoints is None:
        return np.full((1, mapping.actuators), np.nan)
    return _scaled(columns, mapping.setpoints.columns, mapping.setpoints.unit)


def _scaled(columns: ColumnReader, keys: tuple[int | str, ...], unit: PressureUnit | tuple[PressureUnit, ...]) -> Array:
    units = unit if isinstance(unit, tuple) else (unit,) * len(keys)
    return columns.read_columns(keys, [PASCALS[word] for word in units])
