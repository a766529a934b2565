"""Errors of a fit on parts of its own data that are left out: by the linearised fit, without another search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.identify.fitting.results import Fit
from model.arrays import Array

# Blocks in time, each of which is left out once.
BLOCKS = 5
# The entries with the highest pressures: the fit without them says how well the rod extrapolates.
_HIGHEST = 0.3
# Fewer entries tell no error of a part that is left out.
_FEWEST = 32


@dataclass(frozen=True)
class LeftOutVariance:
    """Mean square error per axis [m^2], beyond the stated errors, of blocks and of the highest pressures left out."""

    in_range_m2: float
    out_of_range_m2: float


def left_out_variance(fit: Fit) -> LeftOutVariance:
    """How far predictions of the rod are off in the range of its fit and out of it; zero where entries are few."""
    linear = _Linearised.of(fit)
    if len(linear.gap) < _FEWEST:
        return LeftOutVariance(0.0, 0.0)
    stated = float(np.trace(linear.covariance, axis1=1, axis2=2).mean()) / 3
    blocks = linear.left_out([linear.block == b for b in range(BLOCKS)])
    total = linear.pressure_pa.sum(axis=1)
    high = total > np.quantile(total, 1 - _HIGHEST)
    ends = linear.left_out([high])[high] if high.any() else blocks
    inside = max(float((blocks**2).mean()) - stated, 0.0)
    return LeftOutVariance(inside, max(float((ends**2).mean()) - stated, inside))


def blocks_left_out(fit: Fit) -> list[Array]:
    """Errors (M, 3) [m] of the tips of each run: every block in time is predicted by a fit to the others."""
    linear = _Linearised.of(fit)
    errors = linear.left_out([linear.block == b for b in range(BLOCKS)])
    return np.split(errors, np.cumsum(linear.counts)[:-1])


@dataclass(frozen=True)
class _Linearised:
    """Tips of all runs about a solution: gaps (M, 3), and slopes (M, 3, n) by the unknowns.

    known (n, n): information by the priors of the fit. All tips count with one standard deviation.
    """

    gap: Array
    slope: Array
    known: Array
    block: NDArray[np.intp]
    counts: tuple[int, ...]
    pressure_pa: Array
    covariance: Array

    @classmethod
    def of(cls, fit: Fit) -> _Linearised:
        """That of a fit, with the unknowns in standard deviations of their priors."""
        forward = fit.forward
        gaps = [gap[:, :3] for gap in forward.gaps(fit.theta)]
        seen = [poses.has_tip & np.isfinite(gap).all(axis=1) for poses, gap in zip(forward.data, gaps, strict=True)]
        slopes = [slope[:, :3] * forward.std for slope in forward.slopes(fit.theta)]
        counts = tuple(int(own.sum()) for own in seen)
        return cls(
            np.concatenate([gap[own] for gap, own in zip(gaps, seen, strict=True)]),
            np.concatenate([slope[own] for slope, own in zip(slopes, seen, strict=True)]),
            np.eye(len(fit.theta)),
            np.concatenate([np.arange(count) * BLOCKS // max(count, 1) for count in counts]),
            counts,
            np.concatenate([poses.pressure_pa[own] for poses, own in zip(forward.data, seen, strict=True)]),
            np.concatenate([poses.covariance_m2[own] for poses, own in zip(forward.data, seen, strict=True)]),
        )

    def left_out(self, parts: Sequence[NDArray[np.bool_]]) -> Array:
        """Errors (M, 3) of each part (M,) by a Gauss-Newton step to the fit of the others; of the rest the gaps."""
        variance = float((self.gap**2).mean()) or 1.0
        every, errors = np.ones(len(self.gap), np.bool_), self.gap.copy()
        at_all = np.linalg.solve(*self._equations(every, variance))
        for part in parts:
            moved = np.linalg.solve(*self._equations(~part, variance)) - at_all
            errors[part] -= self.slope[part] @ moved
        return errors

    def _equations(self, part: NDArray[np.bool_], variance: float) -> tuple[Array, Array]:
        """Normal matrix (n, n) and right side (n,) of the entries of a part, with the priors."""
        slope, gap = self.slope[part], self.gap[part]
        by = np.einsum("kin,kim->nm", slope, slope, optimize=True) / variance
        return self.known + by, np.einsum("kin,ki->n", slope, gap) / variance
