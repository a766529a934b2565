"""Slopes of a least-squares problem beside central differences."""

from __future__ import annotations

import numpy as np

from calibration.identify.least_squares import LeastSquaresProblem

STEP = 1e-4


def check_slopes(problem: LeastSquaresProblem, shape: tuple[int, int]) -> None:
    """Compare the slopes (K, D, P) of the first run with central differences of its gaps (K, D) of this shape."""
    z = np.linspace(-0.3, 0.3, len(problem.unknowns))
    slopes = problem.slopes(z, range(len(z)))[0]
    assert slopes.shape == (*shape, len(z))
    for i, step in enumerate(np.eye(len(z)) * STEP):
        numerical = (problem.gaps(z - step)[0] - problem.gaps(z + step)[0]) / (2 * STEP)
        np.testing.assert_allclose(slopes[:, :, i], numerical, atol=2e-5 * max(1.0, np.abs(numerical).max()))
