"""The function that an identification minimises over the unknowns theta.

    J(theta) = (y - f(theta))^T R^-1 (y - f(theta)) + (theta - m)^T S^-1 (theta - m)

y are the measured numbers of all runs and f their predictions; R is the covariance of the noise model, the normal prior
of the unknowns has the mean m and the diagonal covariance S. SciPy minimises it as a sum of squares.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from calibration.identify.fitting.noise import Noise
from calibration.identify.prediction.forward_model import ForwardModel
from model.arrays import Array

# Relative changes of J and of theta at convergence; and the most evaluations of one search.
_FTOL, _XTOL, _MOST_EVALUATIONS = 1e-7, 1e-6, 100
# The search begins so far from a bound, in standard deviations of the prior: at a bound its steps have no length.
_INSIDE = 0.01


@dataclass(frozen=True)
class Objective:
    """J with a fixed R: rows (M + n,) whose squares sum to it, and their derivatives by theta (M + n, n)."""

    forward: ForwardModel
    noise: Noise

    def rows(self, theta: Array) -> Array:
        """R^-1/2 (y - f(theta)) and S^-1/2 (theta - m)."""
        gaps = zip(self.noise.runs, self.forward.gaps(theta), strict=True)
        data = [run.whitened_gap(gap).ravel() for run, gap in gaps]
        return np.concatenate([*data, (theta - self.forward.mean) / self.forward.std])

    def slopes(self, theta: Array) -> Array:
        """Derivatives of `rows` by theta."""
        n, slopes = len(theta), zip(self.noise.runs, self.forward.slopes(theta), strict=True)
        data = [-run.whitened(slope).reshape(-1, n) for run, slope in slopes]
        return np.concatenate([*data, np.diag(1 / self.forward.std)])

    def value(self, theta: Array) -> float:
        """J(theta)."""
        return float((self.rows(theta) ** 2).sum())

    def covariance(self, theta: Array) -> Array:
        """Covariance (n, n) of theta by the curvature of J: (F^T R^-1 F + S^-1)^-1 with F = df/dtheta."""
        scaled = self.slopes(theta) * self.forward.std
        inverse = np.linalg.inv(scaled.T @ scaled)
        return np.asarray(self.forward.std[:, None] * inverse * self.forward.std)

    def minimum(self, theta: Array, progress: Callable[[Array], None]) -> tuple[Array, bool]:
        """The minimum of J from a start within the bounds, and whether the search converged."""

        # In standard deviations of the prior: lengths, pressures and angles have one scale, as the test for
        # convergence takes the norm of all of them.
        mean, std = self.forward.mean, self.forward.std

        def slopes(scaled: Array) -> Array:
            progress(mean + std * scaled)
            return np.asarray(self.slopes(mean + std * scaled) * std)

        ends = (np.array([getattr(one, end) for one in self.forward.unknowns]) for end in ("lower", "upper"))
        lower, upper = ((bound - mean) / std for bound in ends)
        found = least_squares(
            lambda scaled: self.rows(mean + std * scaled),
            np.clip((theta - mean) / std, lower + _INSIDE, upper - _INSIDE),
            slopes,
            bounds=(lower, upper),
            x_scale="jac",
            ftol=_FTOL,
            xtol=_XTOL,
            max_nfev=_MOST_EVALUATIONS,
        )
        return mean + std * found.x, found.status > 0
