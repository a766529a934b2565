"""Profile likelihood: the rise of the loss along each parameter, minimised over all others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from calibration.identify.results import Estimate, Fit
from model.arrays import Array

# Rise of the sum of squares at the ends of a 95 % interval (likelihood ratio, chi-squared).
RISE_95 = float(chdtri(1, 0.05))
# Points of a profile, in standard deviations to either side.
_STEPS = (0.7, 1.4, 2.0, 2.8, 4.0, 6.0)
_EVALUATIONS = 6


@dataclass(frozen=True)
class LikelihoodProfile:
    """One parameter's profile: the least rise (m,) of the robust sum of squares over its optimum, at values (m,).

    interval: the 95 % ends; None if the profile stays below `RISE_95` up to the bound or one plausible span.
    """

    name: str
    unit: str
    run: str
    best: float
    values: Array
    rise: Array
    interval: tuple[float | None, float | None]

    @property
    def flat(self) -> bool:
        """Whether the interval is open on both sides."""
        return self.interval == (None, None)


def profiles(
    fit: Fit, chosen: Callable[[Estimate], bool] | None = None, progress: Callable[[int, int], None] | None = None
) -> tuple[LikelihoodProfile, ...]:
    """Profile the estimates for which `chosen` holds, by default all shared ones that are free.

    A fixed parameter is free for its own profile; the other fixed ones stay fixed.
    """
    wanted = [i for i, e in enumerate(fit.estimates) if (not e.run and not e.nuisance if chosen is None else chosen(e))]
    out = []
    for done, i in enumerate(wanted, start=1):
        out.append(_profile(fit, i))
        if progress is not None:
            progress(done, len(wanted))
    return tuple(out)


def _profile(fit: Fit, i: int) -> LikelihoodProfile:
    problem, solution = fit.problem, fit.solution
    unknown, estimate = problem.unknowns[i], fit.estimates[i]
    others = [j for j in range(len(problem.unknowns)) if j != i and fit.covariance[j, j] > 0]
    # First-order prediction of the other parameters: from far off the Huber loss is too flat for the search.
    slope = fit.covariance[others, i] / (fit.covariance[i, i] or np.inf)
    rates = problem.rates(solution.z)
    deviation = min(estimate.joint_std / rates[i], 0.25)
    lowest = problem.loss(solution.z, solution.weights, solution.correlation)
    points = {float(solution.z[i]): 0.0}
    for side in (-1.0, 1.0):
        z = solution.z.copy()
        limit = unknown.lower if side < 0 else unknown.upper
        limit = max(limit, solution.z[i] - 1.0) if side < 0 else min(limit, solution.z[i] + 1.0)
        for step in (*_STEPS, np.inf):
            at = solution.z[i] + side * step * deviation
            to = max(at, limit) if side < 0 else min(at, limit)
            z[others] += slope * (to - z[i]) * rates[i] / rates[others]
            z[i] = to
            if others:
                z, _ = problem.gauss_newton(z.copy(), others, solution.weights, solution.correlation, _EVALUATIONS)
            rise = problem.loss(z, solution.weights, solution.correlation) - lowest
            points[float(z[i])] = max(rise, 0.0)
            if rise > RISE_95 * 1.3 or z[i] == limit:
                break
    found = np.array(sorted(points.items()))
    values = np.array([unknown.at(z) for z in found[:, 0].tolist()])
    best = unknown.at(float(solution.z[i]))
    return LikelihoodProfile(
        name=estimate.name,
        unit=estimate.unit,
        run=estimate.run,
        best=float(best),
        values=values,
        rise=found[:, 1],
        interval=(_end(values, found[:, 1], best, -1), _end(values, found[:, 1], best, 1)),
    )


def _end(values: Array, rise: Array, best: float, side: int) -> float | None:
    """Crossing of `RISE_95` on one side, by linear interpolation of the root of the rise."""
    part = values <= best if side < 0 else values >= best
    x, height = values[part][:: side if side < 0 else 1], np.sqrt(rise[part][:: side if side < 0 else 1])
    over = np.flatnonzero(height >= np.sqrt(RISE_95))
    if not len(over) or over[0] == 0:
        return None
    k = int(over[0])
    share = (np.sqrt(RISE_95) - height[k - 1]) / (height[k] - height[k - 1])
    return float(x[k - 1] + share * (x[k] - x[k - 1]))
