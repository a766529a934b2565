"""Gauss-Newton method for bounded nonlinear least squares, with Levenberg damping and geodesic acceleration."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from model.arrays import Array

_MAX_STEP = 1.0
# Levenberg damping, in sums of squares per squared span: the first value, and the value below which it is zero.
_FIRST_DAMPING, _LAST_DAMPING = 1.0, 1e-3
# Growth of the damping after a step that was refused.
_MORE_DAMPING = 4.0
# A step longer than so many spans and an error bar, which is a predicted decrease of one, is corrected for the
# curvature of its path, probed at a share of the step: in a shorter one the probe would see the tolerance of the model.
# Once a step was refused, the path is curved on the scale of an error bar, and shorter ones are corrected, too.
_STRAIGHT, _ERROR_BAR, _PROBE = 3e-3, 1.0, 0.1
# A step is refused if this correction is a larger share of it.
_MAX_BEND = 0.4
# Predicted decrease of the sum of squares at convergence: a step of some hundredths of an error bar.
_CONVERGED = 1e-3


def gauss_newton(
    residuals: Callable[[Array], Array],
    jacobian: Callable[[Array], Array],
    x: Array,
    bounds: tuple[Array, ...],
    evaluations: int,
    progress: Callable[[Array], None],
) -> tuple[Array, bool]:
    """Minimise the sum of squares of residuals (m,) over x (n,), and tell whether the search converged.

    jacobian: (m, n). x: the start, scaled so that one is a large change. bounds: lower and upper (n,), kept by an
    active set. progress is called with x after each step.

    Levenberg damping, uniform in x, shortens steps along poorly determined directions, where the problem is
    least linear, and hardly affects the others. Marquardt damping, scaled by the curvature, would slow down all
    correlated unknowns.
    """
    lower, upper = bounds
    x = np.clip(x, lower, upper)
    residual = residuals(x)
    damping = 0.0
    slope: Array | None = None
    least = _ERROR_BAR
    for _ in range(evaluations):
        if slope is None:
            slope = jacobian(x)
        descent = -slope.T @ residual
        at_bound = ((x <= lower) & (descent < 0)) | ((x >= upper) & (descent > 0))
        inside = np.flatnonzero(~at_bound)
        curvature = (slope.T @ slope)[np.ix_(inside, inside)] + damping * np.eye(len(inside))
        step = np.zeros(len(x))
        step[inside] = np.linalg.solve(curvature, descent[inside])
        predicted_decrease = float(step @ descent)
        step *= min(1.0, _MAX_STEP / max(np.abs(step).max(initial=0.0), 1e-300))
        bend = np.zeros(len(x))
        if np.abs(step).max(initial=0.0) > _STRAIGHT and predicted_decrease > least:
            second = _second_derivative(residuals, x, residual, slope @ step, step)
            bend[inside] = -0.5 * np.linalg.solve(curvature, slope[:, inside].T @ second)
        trial = np.clip(x + step + bend, lower, upper)
        straight = np.abs(bend).max(initial=0.0) <= _MAX_BEND * np.abs(step).max(initial=0.0)
        there = residuals(trial) if straight else None
        if there is not None and float(there @ there) <= float(residual @ residual):
            x, residual, slope = trial, there, None
            progress(x)
            damping = damping / 10 if damping > _LAST_DAMPING else 0.0
        else:
            damping = max(_MORE_DAMPING * damping, _FIRST_DAMPING)
            least = _CONVERGED
        if predicted_decrease < _CONVERGED:
            return x, True
    return x, False


def _second_derivative(
    residuals: Callable[[Array], Array], x: Array, residual: Array, first: Array, step: Array
) -> Array:
    """Second derivative of the residuals along a step whose first-order effect is `first`.

    With it a step follows a curved valley (geodesic acceleration, Transtrum and Sethna 2012).
    """
    out: Array = 2 / _PROBE * ((residuals(x + _PROBE * step) - residual) / _PROBE - first)
    return out
