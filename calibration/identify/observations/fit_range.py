"""The range of a fit: pressures, combinations of chambers and loads, and which of them a predicted run leaves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.identify.observations.poses import Poses
from model.arrays import Array
from model.units import GRAVITY_M_S2, PA_PER_BAR

# A run leaves the range if it exceeds it by more than this share, and by this amount.
_SHARE, _PRESSURE_PA, _LOAD_N = 0.05, 2e3, 0.05
# A chamber is pressed above this share of the largest pressure of the fit.
_PRESSED = 0.1


def loaded(data: Sequence[Poses]) -> bool:
    """Whether a load was on the arm in any of the runs."""
    return any(load_n(poses) > _LOAD_N for poses in data)


def load_n(poses: Poses) -> float:
    """The largest load [N] of a run: hung weight and measured force."""
    return float(_loads_n(poses).max(initial=0.0))


def outside(data: Sequence[Poses], predicted: Poses) -> tuple[str, ...]:
    """Where a predicted run leaves the range of the runs of the fit, one sentence each."""
    fitted = np.max([poses.pressure_pa.max(axis=0) for poses in data], axis=0)
    there = predicted.pressure_pa.max(axis=0)
    found = [
        f"the pressure of chamber {n + 1} reaches {there[n] / PA_PER_BAR:.2f} bar, "
        f"{fitted[n] / PA_PER_BAR:.2f} bar in the fit"
        for n in np.flatnonzero(there > (1 + _SHARE) * fitted + _PRESSURE_PA).tolist()
    ]
    least = _PRESSED * float(fitted.max())
    known = set[tuple[int, ...]]().union(*(_combinations(poses, least) for poses in data))
    if new := sorted(_combinations(predicted, least) - known):
        names = "; ".join(" and ".join(str(n + 1) for n in one) for one in new)
        found.append(f"these chambers are pressed together, but not in the fit: {names}")
    most, fitted_n = load_n(predicted), max(load_n(poses) for poses in data)
    if most > (1 + _SHARE) * fitted_n + _LOAD_N:
        reason = "" if loaded(data) else ", so the stiffness under load is undetermined"
        found.append(f"the load reaches {most:.2f} N, {fitted_n:.2f} N in the fit{reason}")
    return tuple(found)


def outside_entries(data: Sequence[Poses], predicted: Poses) -> NDArray[np.bool_]:
    """Which entries (K,) of a predicted run leave the range of the runs of the fit."""
    fitted = np.max([poses.pressure_pa.max(axis=0) for poses in data], axis=0)
    least = _PRESSED * float(fitted.max())
    known = set[tuple[int, ...]]().union(*(_combinations(poses, least) for poses in data))
    high = (predicted.pressure_pa > (1 + _SHARE) * fitted + _PRESSURE_PA).any(axis=1)
    pressed = [tuple(np.flatnonzero(row).tolist()) for row in predicted.pressure_pa > least]
    together = np.array([len(one) > 1 and one not in known for one in pressed], np.bool_)
    heavy = _loads_n(predicted) > (1 + _SHARE) * max(load_n(poses) for poses in data) + _LOAD_N
    out: NDArray[np.bool_] = high | together | heavy
    return out


def _loads_n(poses: Poses) -> Array:
    """Loads (K,) [N]: hung weight and measured force."""
    out: Array = poses.weight_kg * GRAVITY_M_S2 + np.linalg.norm(poses.wrench[:, :3], axis=1)
    return out


def _combinations(poses: Poses, least_pa: float) -> set[tuple[int, ...]]:
    """The sets of chambers that are pressed together, at least two."""
    rows = np.unique(poses.pressure_pa > least_pa, axis=0)
    return {tuple(np.flatnonzero(row).tolist()) for row in rows if row.sum() > 1}
