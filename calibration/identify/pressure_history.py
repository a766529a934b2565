"""History of the pressures at a pose: since, and in which direction they changed; lagged, highest, way so far."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded

from model.arrays import Array
from runs.interpolation import interpolated

# Time constants of the lagged pressures.
LAGS_S = (1.0, 10.0, 100.0)
# A smaller movement of a pressure is no change of its direction.
DEAD_BAND_PA = 300.0
# Samples per second that the history is computed from.
_RATE_HZ = 20.0


@dataclass(frozen=True)
class PressureHistory:
    """The past of the pressures of K poses.

    since_change_s (K,): time since the last change of any pressure. direction (K, N): sign of the last change of each
    pressure, 0 before its first. lagged_pa (K, N, L): the pressures behind first-order lags of `LAGS_S`. highest_pa,
    travelled_pa (K, N): the highest pressure so far, and the way that the pressure has gone up and down.
    """

    since_change_s: Array
    direction: Array
    lagged_pa: Array
    highest_pa: Array
    travelled_pa: Array

    def only(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> PressureHistory:
        """The history of some of the poses."""
        return PressureHistory(
            self.since_change_s[chosen],
            self.direction[chosen],
            self.lagged_pa[chosen],
            self.highest_pa[chosen],
            self.travelled_pa[chosen],
        )


def pressure_history(time_s: Array, pressure_pa: Array, at_s: Array) -> PressureHistory:
    """The history at times (K,) of pressures (n, N) sampled at times (n,); before the first sample they were zero.

    Changes below the dead band are ignored: a play operator follows each pressure.
    """
    count = max(2, 1 + int(np.ceil((time_s[-1] - time_s[0]) * _RATE_HZ)))
    grid_s = np.linspace(time_s[0], time_s[-1], count)
    grid = interpolated(grid_s, time_s, pressure_pa)
    steps = _movements(grid)
    moved = np.sign(steps)
    place = np.clip(np.searchsorted(grid_s, at_s, side="right") - 1, 0, count - 1)
    changed = np.maximum.accumulate(np.where(moved != 0, np.arange(count)[:, None], -1), axis=0)
    last = changed[place]
    direction = np.where(last >= 0, np.take_along_axis(moved, np.maximum(last, 0), axis=0), 0.0)
    since_s = at_s - np.where(last.max(axis=1) >= 0, grid_s[np.maximum(last.max(axis=1), 0)], grid_s[0])
    step_s = grid_s[1] - grid_s[0]
    lagged = []
    for lag_s in LAGS_S:
        keep = np.exp(-step_s / lag_s)
        diagonals = np.array([np.ones(count), np.full(count, -keep)])
        lagged.append(np.asarray(solve_banded((1, 0), diagonals, (1 - keep) * grid))[place])
    highest = np.maximum.accumulate(np.cumsum(steps, axis=0), axis=0)
    travelled = np.cumsum(np.abs(steps), axis=0)
    return PressureHistory(
        np.maximum(since_s, 0.0), direction, np.stack(lagged, axis=2), highest[place], travelled[place]
    )


def _movements(pressure_pa: Array) -> Array:
    """Each movement (n, N) [Pa] of a play operator that follows pressures (n, N) from zero."""
    out, value = np.zeros_like(pressure_pa), np.zeros(pressure_pa.shape[1])
    for k, row in enumerate(pressure_pa):
        followed = np.clip(value, row - DEAD_BAND_PA, row + DEAD_BAND_PA)
        out[k] = followed - value
        value = followed
    return out
