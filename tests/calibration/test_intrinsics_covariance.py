"""Covariance of the intrinsics: it covers errors that the corners of one view share."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.intrinsics_covariance import intrinsics_covariance

VIEWS, CORNERS, POSE, INTRINSICS = 16, 40, 6, 4
TRIALS = 300


def coverage(shared: float) -> float:
    """Share of 95 % intervals that hold the truth, of linear views with noise and an error `shared` by each view."""
    rng = np.random.default_rng(5)
    held = []
    for _ in range(TRIALS):
        slopes = [
            (rng.standard_normal((CORNERS, POSE)), rng.standard_normal((CORNERS, INTRINSICS))) for _ in range(VIEWS)
        ]
        # What a bent board adds to a view: a pattern that the intrinsics can imitate.
        noise = [rng.standard_normal(CORNERS) + shared * own @ rng.standard_normal(INTRINSICS) for _, own in slopes]
        whole = np.zeros((VIEWS * CORNERS, VIEWS * POSE + INTRINSICS))
        for k, (pose, own) in enumerate(slopes):
            rows = slice(k * CORNERS, (k + 1) * CORNERS)
            whole[rows, k * POSE : (k + 1) * POSE], whole[rows, -INTRINSICS:] = pose, own
        measured = np.concatenate(noise)
        solution = np.linalg.lstsq(whole, measured, rcond=None)[0]
        residuals = np.split(measured - whole @ solution, VIEWS)
        std = np.sqrt(np.diag(intrinsics_covariance(slopes, residuals)))
        held.append(np.abs(solution[-INTRINSICS:]) < 1.96 * std)
    return float(np.mean(held))


@pytest.mark.slow
@pytest.mark.parametrize("shared", [0.0, 0.2, 1.0])
def test_intervals_hold_whatever_part_of_the_errors_a_view_shares(shared: float) -> None:
    assert 0.92 <= coverage(shared) <= 0.99
