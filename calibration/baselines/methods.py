"""The baselines: no motion, constant curvature with linear compliance, a quadratic polynomial of the pressures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from scipy.optimize import least_squares

from calibration.baselines.tip_inputs import TipInputs
from model.arrays import Array

# Entries that constant curvature is fitted to: it has some twenty unknowns.
_QUICK, _MOST = 90, 300

PredictTips = Callable[[TipInputs], Array]
"""Predicted tips (K, 3) [m] of the entries; their measured tips are not read."""


class BaselineMethod(Protocol):
    """A method with numbers that are chosen by blocks left out: a lag, and a weight of its regularisation."""

    @property
    def name(self) -> str:
        """Name in tables."""

    @property
    def weights(self) -> tuple[float, ...]:
        """Weights of the regularisation that are tried."""

    def fit(self, data: TipInputs, weight: float, quick: bool = False) -> PredictTips:
        """The predictor that fits the data; `quick`: one of the many fits that only choose lag and weight."""
        ...


class NoMotion:
    """The median tip, whatever the pressures are."""

    name = "no motion"
    weights = (0.0,)

    def fit(self, data: TipInputs, weight: float, quick: bool = False) -> PredictTips:
        """The predictor of the median tip."""
        middle = np.median(data.tip_m, axis=0)
        return lambda inputs: np.broadcast_to(middle, (len(inputs), 3))


class QuadraticPolynomial:
    """Ridge regression of the tips on 1, p_i, p_i p_j, and F_k where a force acts, in the pressures' own scale."""

    name = "quadratic polynomial"
    weights = (1e-6, 1e-4, 1e-2)

    def fit(self, data: TipInputs, weight: float, quick: bool = False) -> PredictTips:
        """The ridge solution; a weight is relative to the mean square of a column."""
        columns = _quadratic(data)
        middle, spread = columns.mean(axis=0), columns.std(axis=0)
        # A column that hardly changes, as of a chamber that is vented throughout, says nothing.
        spread = np.where(spread > 1e-3 * np.abs(columns).max(initial=1e-12), spread, np.inf)
        scaled, mean_m = (columns - middle) / spread, data.tip_m.mean(axis=0)
        normal = scaled.T @ scaled + weight * len(scaled) * np.eye(scaled.shape[1])
        found = np.linalg.solve(normal, scaled.T @ (data.tip_m - mean_m))
        return lambda inputs: ((_quadratic(inputs) - middle) / spread) @ found + mean_m


def _quadratic(data: TipInputs) -> Array:
    """Columns p_i, p_i p_j, F_k (K, ..)."""
    p = data.pressure_bar
    first, second = np.triu_indices(p.shape[1])
    out: Array = np.concatenate([p, p[:, first] * p[:, second], data.force_n], axis=1)
    return out


class ConstantCurvature:
    """One arc whose curvature and length follow the pressures, with a linear compliance to a force at its tip.

    Unknowns: the curvature of each chamber along two axes, per bar and in 1/length; growth of the push and stretch per
    bar; length, base (3) and tool (3) in lengths; two tilts of the base; compliance in bending and along the axis, per
    newton. All but the curvatures are held near their start by priors.
    """

    name = "constant curvature"
    weights = (1.0,)
    # A fit to a hundredth of the length counts as much as a prior that is ten standard deviations off.
    _ERROR, _PRIOR_WEIGHT = 1e-2, 0.1
    # Standard deviations of the priors: growth, stretch, length, base, tool, tilts, bending and axial compliance.
    _PRIOR = (1.0, 0.3, 0.1, *[0.1] * 3, *[0.1] * 3, *[0.3] * 2, 2.0, 0.5)

    def fit(self, data: TipInputs, weight: float, quick: bool = False) -> PredictTips:
        """The least-squares solution from a linear regression of the tips as the start."""
        data = data.only(np.linspace(0, len(data) - 1, min(len(data), _QUICK if quick else _MOST)).astype(int))
        chambers = data.pressure_bar.shape[1]
        still = np.argsort(np.abs(data.pressure_bar).sum(axis=1))[: max(1, len(data) // 20)]
        length_m = max(float(np.median(data.tip_m[still, 2])), 1e-3)
        tip = data.tip_m / length_m
        pushed = data.pressure_bar - data.pressure_bar[still].mean(axis=0)
        across = np.linalg.lstsq(
            np.concatenate([pushed, 1e-2 * np.eye(chambers)]),
            np.concatenate([tip[:, :2] - np.median(tip[still, :2], axis=0), np.zeros((chambers, 2))]),
            rcond=None,
        )[0]
        first = np.zeros(2 * chambers + len(self._PRIOR))
        first[: 2 * chambers] = 2 * across.ravel()
        first[2 * chambers + 2] = 1.0
        # A curvature is free within what would wind the arm up at one bar.
        scale = np.concatenate([np.full(2 * chambers, 5.0), self._PRIOR])
        centre = first.copy()
        centre[: 2 * chambers] = 0.0

        def residual(many: Array) -> Array:
            gap = (_arc_tips(many, data.pressure_bar, data.force_n) - tip) / self._ERROR
            rows = gap.reshape(len(many), -1) / np.sqrt(len(data))
            return np.concatenate([rows, self._PRIOR_WEIGHT * weight * (many - centre) / scale], axis=1)

        def jacobian(theta: Array) -> Array:
            steps = 1e-6 * scale
            every = residual(np.concatenate([theta[None], theta + np.diag(steps)]))
            out: Array = (every[1:] - every[0]).T / steps
            return out

        found = least_squares(
            lambda theta: residual(theta[None])[0],
            first,
            jacobian,
            x_scale=scale,
            ftol=1e-3 if quick else 1e-6,
            xtol=1e-3 if quick else 1e-6,
            max_nfev=20 if quick else 60,
        ).x
        return lambda inputs: length_m * _arc_tips(found[None], inputs.pressure_bar, inputs.force_n)[0]


def _arc_tips(many: Array, pressure_bar: Array, force_n: Array) -> Array:
    """Tips (M, K, 3) in lengths by M sets of unknowns (M, U) under pressures (K, N) and forces (K, 3)."""
    count, chambers = len(many), pressure_bar.shape[1]
    bend = many[:, : 2 * chambers].reshape(count, chambers, 2)
    growth, stretch, length, *rest = (column[:, None] for column in many[:, 2 * chambers :].T)
    base, tool = np.stack(rest[:3], axis=-1), np.stack(rest[3:6], axis=-1)
    turn, by_bending, by_axial = np.stack([rest[6], rest[7], 0 * rest[7]], axis=-1), rest[8], rest[9]
    push = pressure_bar[None] * (1 + growth[:, :, None] * pressure_bar[None])
    local = _turned(-turn, np.broadcast_to(force_n, (count, *force_n.shape)))
    curvature = push @ bend + by_bending[:, :, None] * local[:, :, :2]
    arc = length * (1 + stretch * push.sum(axis=2) + by_axial * local[:, :, 2])
    total = np.linalg.norm(curvature, axis=2) + 1e-9
    c, s, angle = curvature[:, :, 0] / total, curvature[:, :, 1] / total, total * arc
    radius, height = (1 - np.cos(angle)) / total, np.sin(angle) / total
    bent = np.stack([-s * angle, c * angle, np.zeros_like(s)], axis=2)
    end = np.stack([radius * c, radius * s, height], axis=2) + _turned(bent, np.broadcast_to(tool, bent.shape))
    out: Array = _turned(turn, end) + base
    return out


def _turned(rotation: Array, vectors: Array) -> Array:
    """Vectors (M, K, 3) turned by rotation vectors (M, 1 or K, 3), by the formula of Rodrigues."""
    angle = np.linalg.norm(rotation, axis=2, keepdims=True)
    axis = rotation / np.maximum(angle, 1e-12)
    cosine, sine = np.cos(angle), np.sin(angle)
    along = (axis * vectors).sum(axis=2, keepdims=True)
    (a, b, c), (x, y, z) = np.moveaxis(axis, 2, 0), np.moveaxis(vectors, 2, 0)
    across = np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=2)
    out: Array = vectors * cosine + across * sine + axis * along * (1 - cosine)
    return out


BASELINES: tuple[BaselineMethod, ...] = (NoMotion(), ConstantCurvature(), QuadraticPolynomial())
