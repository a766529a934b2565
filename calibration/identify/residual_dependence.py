"""What the residuals of a fit depend on, by a permutation test that is sound for correlated frames.

The residuals of each run are exchanged: those of plateaus at random, those of consecutive frames by circular shifts,
which keep their correlation. A dependence is significant if few exchanges show as much of it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.identify.likelihood import outlying, whitened
from calibration.identify.poses import Poses
from calibration.identify.results import Fit
from model.arrays import Array

_PERMUTATIONS = 999
# Largest probability of a significant dependence.
SIGNIFICANT = 0.01
# Directions of the covariates with a smaller share of the largest singular value are noise.
_RANK = 1e-6


@dataclass(frozen=True)
class Dependence:
    """How the residuals depend on one quantity.

    share: of the variance of the residuals within runs that a linear function of the quantity explains. p_value:
    probability of such a share without a dependence. Both are None if the quantity does not vary within a run.
    """

    quantity: str
    about: str
    share: float | None
    p_value: float | None

    @property
    def significant(self) -> bool:
        """Whether the residuals depend on it."""
        return self.p_value is not None and self.p_value < SIGNIFICANT


def _pressure(poses: Poses) -> Array:
    return np.concatenate([poses.pressure_pa, poses.pressure_pa**2], axis=1)


def _time_since_step(poses: Poses) -> Array:
    return (poses.pressure_pa[:, :, None] - poses.history.lagged_pa).reshape(len(poses), -1)


def _direction(poses: Poses) -> Array:
    return poses.history.direction


def _combination(poses: Poses) -> Array:
    pairs = itertools.combinations(range(poses.actuators), 2)
    return np.array([poses.pressure_pa[:, i] * poses.pressure_pa[:, j] for i, j in pairs]).reshape(-1, len(poses)).T


def _load(poses: Poses) -> Array:
    return np.column_stack([poses.weight_kg, poses.wrench])


_COVARIATES: tuple[tuple[str, str, Callable[[Poses], Array]], ...] = (
    ("pressure", "pressure of each chamber and its square", _pressure),
    ("time since step", "pressures minus their lagged values", _time_since_step),
    ("direction", "sign of the last change of each pressure", _direction),
    ("chamber combination", "products of the pressures of two chambers", _combination),
    ("load", "weight, measured force and moment", _load),
)


def residual_dependence(fit: Fit) -> tuple[Dependence, ...]:
    """The dependence of a fit's residuals on each quantity, of the positions only."""
    residuals, chosen = [], []
    for poses, run, weights in zip(fit.problem.data, fit.runs, fit.solution.weights, strict=True):
        rows = whitened(poses, run.gap, weights)[:, :3]
        good = poses.has_tip & ~outlying(rows)
        residuals.append(rows[good])
        chosen.append(poses.only(good))
    return dependence(residuals, chosen, [poses.in_sequence for poses in fit.problem.data])


def dependence(
    residuals: Sequence[Array], data: Sequence[Poses], in_sequence: Sequence[bool]
) -> tuple[Dependence, ...]:
    """The dependence of residuals (K, 3) of each run on each quantity; in_sequence: of consecutive frames."""
    rng = np.random.default_rng(0)
    centred = [rows - rows.mean(axis=0) if len(rows) else rows for rows in residuals]
    total = sum(float((rows**2).sum()) for rows in centred)
    orders = [_orders(len(rows), frames, rng) for rows, frames in zip(centred, in_sequence, strict=True)]
    out = []
    for quantity, about, covariates in _COVARIATES:
        basis = _basis([covariates(poses) for poses in data])
        if basis is None or total == 0.0:
            out.append(Dependence(quantity, about, None, None))
            continue
        explained = np.zeros((_PERMUTATIONS + 1, basis[0].shape[1], 3))
        for rows, order, part in zip(centred, orders, basis, strict=True):
            for k, one in enumerate(order):
                explained[k] += part.T @ rows[one]
        found = (explained**2).sum(axis=(1, 2))
        p_value = float((found >= found[0] * (1 - 1e-9)).mean())
        out.append(Dependence(quantity, about, float(found[0]) / total, p_value))
    return tuple(out)


def _orders(count: int, frames: bool, rng: np.random.Generator) -> list[NDArray[np.intp]]:
    """Orders of the residuals of one run: as they are, then exchanged."""
    if not count:
        return []
    own = np.arange(count)
    if frames:
        return [own, *((own + shift) % count for shift in rng.integers(0, count, _PERMUTATIONS).tolist())]
    return [own, *(rng.permutation(count) for _ in range(_PERMUTATIONS))]


def _basis(covariates: Sequence[Array]) -> list[Array] | None:
    """Orthonormal columns, by run, of covariates (K, c) about their means in each run; None if they are constant."""
    centred = [rows - rows.mean(axis=0) if len(rows) else rows for rows in covariates]
    every = np.concatenate(centred)
    scale = np.abs(np.concatenate(covariates)).max(axis=0)
    varies = np.abs(every).max(axis=0) > 1e-9 * scale
    if not varies.any():
        return None
    every = every[:, varies] / every[:, varies].std(axis=0)
    left, values, _ = np.linalg.svd(every, full_matrices=False)
    columns = left[:, values > _RANK * values[0]]
    return np.split(columns, np.cumsum([len(rows) for rows in centred])[:-1])
