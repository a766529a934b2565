"""Errors of a fit on blocks of its own data that are left out: by the linearised fit, without another search."""

from __future__ import annotations

import numpy as np

from calibration.identify.results import Fit
from model.arrays import Array

# Weak prior, in spans, that keeps unknowns finite which the other blocks leave open.
_WEAK_SPANS = 2.0


def blocks_left_out(fit: Fit, blocks: int) -> list[Array]:
    """Errors (M, 3) [m] of the tips of each run: every block in time is predicted by a fit to the others.

    Gauss-Newton from the solution, with the priors of the fit and one standard deviation for all tips. What was held
    stays held.
    """
    problem, z = fit.problem, fit.solution.z
    free = [i for i, fixed in enumerate(fit.fixed) if not fixed]
    seen = [
        poses.has_tip & np.isfinite(gap[:, :3]).all(axis=1)
        for poses, gap in zip(problem.data, problem.gaps(z), strict=True)
    ]
    gaps = [gap[own][:, :3] for gap, own in zip(problem.gaps(z), seen, strict=True)]
    slopes = [slope[own][:, :3][:, :, free] for slope, own in zip(problem.slopes(z, range(len(z))), seen, strict=True)]
    every, by = np.concatenate(gaps), np.concatenate(slopes)
    block = np.concatenate([np.arange(len(one)) * blocks // max(len(one), 1) for one in gaps])
    variance = float((every**2).mean()) or 1.0
    prior = problem.prior_rows(z)[0][:, free]
    known = prior.T @ prior + np.eye(len(free)) / _WEAK_SPANS**2
    own_by = [np.einsum("kin,kim->nm", by[block == b], by[block == b]) / variance for b in range(blocks)]
    own_gap = [np.einsum("kin,ki->n", by[block == b], every[block == b]) / variance for b in range(blocks)]
    whole_by, whole_gap = known + np.sum(own_by, axis=0), np.sum(own_gap, axis=0)
    at_all = np.linalg.solve(whole_by, whole_gap)
    errors = every.copy()
    for b in range(blocks):
        moved = np.linalg.solve(whole_by - own_by[b], whole_gap - own_gap[b]) - at_all
        errors[block == b] -= by[block == b] @ moved
    return np.split(errors, np.cumsum([len(one) for one in gaps])[:-1])
