"""The Gauss-Newton method follows curved valleys down to their minimum."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.identify.gauss_newton import gauss_newton
from model.arrays import Array

# Error bars along and across the valley y = BEND x^2, in spans.
ALONG, ACROSS, BEND = 0.05, 1e-4, 4.0
BOUNDS = (np.full(2, -5.0), np.full(2, 5.0))


def valley(x: Array) -> Array:
    return np.array([x[0] / ALONG, (x[1] - BEND * x[0] ** 2) / ACROSS])


def slopes(x: Array) -> Array:
    return np.array([[1 / ALONG, 0.0], [-2 * BEND * x[0] / ACROSS, 1 / ACROSS]])


@pytest.mark.parametrize("error_bars", [0.5, 0.8])
def test_a_search_along_a_curved_valley_converges(error_bars: float) -> None:
    at = ALONG * error_bars
    calls: list[Array] = []
    found, converged = gauss_newton(valley, slopes, np.array([at, BEND * at**2]), BOUNDS, 40, calls.append)
    assert converged
    assert len(calls) < 12
    assert found == pytest.approx(np.zeros(2), abs=0.05 * ALONG)
