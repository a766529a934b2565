"""Information matrices: one unknown that is known to many digits leaves the others as uncertain as they are."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.identify.information import covariance, determined_covariance, sandwich

ENTANGLED = np.array([[4.0, 3.9], [3.9, 4.0]])
"""Known well together and badly apart: eigenvalues 7.9 and 0.1."""


def beside_a_precise_unknown(matrix: np.ndarray, precise: float) -> np.ndarray:
    out = np.zeros((3, 3))
    out[:2, :2], out[2, 2] = matrix, precise
    return out


@pytest.mark.parametrize("precise", [1.0, 1e8, 1e18])
@pytest.mark.parametrize("function", [covariance, determined_covariance])
def test_a_precise_unknown_leaves_the_covariance_of_the_others(function: object, precise: float) -> None:
    assert callable(function)
    found = function(beside_a_precise_unknown(ENTANGLED, precise))
    assert found[:2, :2] == pytest.approx(np.linalg.inv(ENTANGLED), rel=1e-9)
    assert found[2, 2] == pytest.approx(1 / precise)


@pytest.mark.parametrize("precise", [1.0, 1e8, 1e18])
def test_a_precise_unknown_leaves_the_sandwich_information_of_the_others(precise: float) -> None:
    score = np.array([[8.0, 1.0], [1.0, 6.0]])
    expected = ENTANGLED @ np.linalg.inv(score) @ ENTANGLED
    found = sandwich(beside_a_precise_unknown(ENTANGLED, precise), beside_a_precise_unknown(score, precise))
    assert found[:2, :2] == pytest.approx(expected, rel=1e-9)
    assert found[2, 2] == pytest.approx(precise)


def test_without_information_the_covariance_is_very_large_or_zero_as_asked() -> None:
    exchangeable = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    large, zero = covariance(exchangeable), determined_covariance(exchangeable)
    assert np.isfinite(large).all()
    assert large.diagonal().min() > 1e6
    assert zero == pytest.approx(np.array([[0.25, 0.25, 0.0], [0.25, 0.25, 0.0], [0.0, 0.0, 0.0]]))
