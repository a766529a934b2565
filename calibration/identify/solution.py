"""The result of a maximum-likelihood search."""

from __future__ import annotations

from dataclasses import dataclass

from calibration.identify.likelihood import Discrepancy, Weights
from model.arrays import Array

# Correlation factors that differ by a smaller share give the same estimate.
_SAME_CORRELATION = 0.1


@dataclass(frozen=True)
class Solution:
    """The maximum of the likelihood. z (n,) in spans; information (n, n) of data and priors, without the ridge."""

    z: Array
    information: Array
    prior_information: Array
    loss: float
    """Robust sum of squares, priors included, at the final weights."""
    log_likelihood: float
    discrepancy: Discrepancy
    correlation: tuple[float, ...]
    """Of each run: so many correlated entries count as one; at least 1."""
    weights: tuple[Weights, ...]
    solved: bool

    def close_to(self, other: Solution) -> bool:
        """Whether it weighs the data as another does."""
        factors = zip(self.correlation, other.correlation, strict=True)
        return self.discrepancy.close_to(other.discrepancy) and all(
            abs(one - there) <= _SAME_CORRELATION * one for one, there in factors
        )

    @property
    def discrepancy_m(self) -> float:
        """Standard deviation [m] per axis of the tips that no stated error explains."""
        return self.discrepancy.tip_m
