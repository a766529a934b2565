"""A pressure sensor's scale from readings of a gauge: the line, and how well it is known."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.camera import CalibrationError
from calibration.pressure import fit_sensor

VOLTS = np.linspace(0.5, 6.5, 7)
TRUE = np.array([1200.0, 0.99e5])


def off(gauge_std_pa: float, scatter_pa: float, trials: int = 400) -> float:
    """Mean square of the errors of offset and scale in their stated covariance; 2 where that is right."""
    rng = np.random.default_rng(3)
    squares = []
    for _ in range(trials):
        found = fit_sensor(VOLTS, TRUE[0] + TRUE[1] * VOLTS + scatter_pa * rng.standard_normal(7), gauge_std_pa)
        error = np.array([found.offset_pa, found.scale_pa_per_v]) - TRUE
        squares.append(error @ np.linalg.solve(found.covariance, error))
    return float(np.mean(squares))


def test_readings_on_a_line_give_the_line() -> None:
    found = fit_sensor(VOLTS, TRUE[0] + TRUE[1] * VOLTS, 500.0)
    assert (found.offset_pa, found.scale_pa_per_v) == pytest.approx(tuple(TRUE))
    assert found.residuals_pa == pytest.approx(np.zeros(7), abs=1e-6)


def test_the_covariance_follows_from_the_stated_accuracy_of_the_gauge() -> None:
    assert 1.4 < off(gauge_std_pa=200.0, scatter_pa=200.0) < 2.2


def test_readings_that_scatter_more_than_the_gauge_should_enlarge_the_covariance() -> None:
    # The scatter of seven readings about a line is itself known roughly only: 10/3 is the mean of such squares.
    assert 1.4 < off(gauge_std_pa=20.0, scatter_pa=200.0) < 5.0


def test_two_readings_are_as_good_as_the_gauge() -> None:
    found = fit_sensor(np.array([0.0, 5.0]), np.array([0.0, 5e5]), 300.0)
    assert np.sqrt(found.covariance[0, 0]) == pytest.approx(300.0)
    assert np.sqrt(found.covariance[1, 1]) == pytest.approx(300.0 * np.sqrt(2) / 5)


@pytest.mark.parametrize("volts", [[2.0], [2.0, 2.01, 2.02]])
def test_readings_at_one_pressure_determine_no_scale(volts: list[float]) -> None:
    with pytest.raises(CalibrationError, match="two pressures"):
        fit_sensor(np.array(volts), np.full(len(volts), 2e5), 300.0)
