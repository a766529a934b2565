"""The objective is the formula of the page, and another program reproduces estimates and error bars from the export."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.optimize import least_squares

import model
from calibration.identify import Fit, Poses, Prior, Setup, identify
from calibration.identify.fitting.export import write
from calibration.identify.fitting.noise import NOISE_MODELS, Noise, RunNoise
from calibration.identify.fitting.objective import Objective
from calibration.identify.simulated_experiments import MeasurementErrors, plan
from calibration.identify.unknowns.nuisance import stated_values
from model.statics import statics
from tests.support.finite_differences import forward_of

START = Setup(model.Arm.paper())
ERRORS = MeasurementErrors((2e-4, 3e-4, 2e-4), 10.0, 0.0)
PRESSURES = np.random.default_rng(2).uniform(0.05e5, 0.6e5, (12, 3))
FREE = ("a1_per_n", "base_x_m", "base_z_m")


def measured(seed: int = 1, scale: float = 1.0) -> Poses:
    """Tips of a softer arm by the solver of single equilibria, which the fit does not use."""
    material = replace(START.arm.material, a1_per_n=1.1 * START.arm.material.a1_per_n)
    arm, rng = START.arm.with_segment(material=material), np.random.default_rng(seed)
    tips = np.array([statics(arm, row).tip_m for row in PRESSURES])
    noise = scale * rng.standard_normal(tips.shape) * ERRORS.tip_m
    return replace(plan("run", PRESSURES, errors=ERRORS), tip_m=tips + noise)


def test_the_value_is_the_formula() -> None:
    forward = forward_of([measured()], START, FREE)
    rng = np.random.default_rng(3)
    blocks = [root @ root.T + 1e-8 * np.eye(3) for root in 1e-4 * rng.standard_normal((12, 3, 3))]
    objective = Objective(forward, Noise((RunNoise(np.array(blocks), forward.data[0].measured),), {}))
    theta = forward.first + 0.1 * forward.span
    y_minus_f, R = forward.gaps(theta)[0].ravel(), block_diag(*blocks)
    S, off = np.diag(forward.std**2), theta - forward.mean
    expected = y_minus_f @ np.linalg.solve(R, y_minus_f) + off @ np.linalg.solve(S, off)
    assert objective.value(theta) == pytest.approx(expected, rel=1e-9)
    F = forward.slopes(theta)[0].reshape(-1, 3)
    by_formula = np.linalg.inv(F.T @ np.linalg.solve(R, F) + np.linalg.inv(S))
    np.testing.assert_allclose(objective.covariance(theta), by_formula, rtol=1e-6)


@pytest.mark.parametrize("noise", NOISE_MODELS)
def test_twenty_lines_of_scipy_reproduce_estimates_and_bars_from_the_export(tmp_path: Path, noise: str) -> None:
    stated = stated_values(START, {})
    fit = identify([measured(scale=3.0)], START, ("a1_per_n", "base"), stated=stated, noise=noise)
    with np.load(write(fit, tmp_path / "fit.npz")) as file:
        saved = dict(file)
    residual, jacobian, theta = saved["residual"], saved["jacobian"], saved["theta"]
    root = np.zeros((len(residual), len(residual)))
    for number, block in enumerate(saved["covariance"]):
        rows = np.flatnonzero(saved["entry"] == number)
        used = saved["place"][rows]
        root[np.ix_(rows, rows)] = np.linalg.inv(np.linalg.cholesky(block[np.ix_(used, used)]))

    def rows(step: np.ndarray) -> np.ndarray:
        moved = theta + step * saved["prior_std"]
        data = root @ (residual - jacobian @ (moved - theta))
        return np.concatenate([data, (moved - saved["prior_mean"]) / saved["prior_std"]])

    found = least_squares(rows, np.full(len(theta), 0.3))
    bars = saved["prior_std"] * np.sqrt(np.diagonal(np.linalg.inv(found.jac.T @ found.jac)))
    np.testing.assert_allclose(bars, saved["std"], rtol=1e-3)
    moved = found.x * saved["prior_std"] / bars
    assert np.abs(moved).max() < 0.05, "estimates differ by more than a twentieth of an error bar"
    assert saved["name"].tolist() == [one.name for one in fit.estimates]


def test_white_noise_is_weighted_least_squares_with_the_stated_errors() -> None:
    far = measured()
    far.tip_m[3] += 5e-3
    white = identify([far], START, FREE, noise="white")
    np.testing.assert_array_equal(white.noise.runs[0].covariance, far.covariance_m2)
    assert white.runs[0].outliers >= 1
    # The other model weighs the wrong tip less and is nearer to the truth.
    true = 1.1 * START.arm.material.a1_per_n
    adaptive = identify([far], START, FREE)
    assert abs(adaptive["a1_per_n"].used - true) < abs(white["a1_per_n"].used - true)


def test_the_end_of_a_search_is_never_worse_than_its_start() -> None:
    softer = replace(START.arm.material, a1_per_n=1.1 * START.arm.material.a1_per_n)
    true = Setup(START.arm.with_segment(material=softer))
    for start in (START, true):
        for data in (measured(scale=0.3), measured(scale=10.0)):
            fit: Fit = identify([data], start, FREE)
            assert fit.objective.value(fit.theta) <= fit.objective.value(fit.forward.first)


def test_a_free_parameter_feels_what_is_stated_of_it() -> None:
    a1 = START.arm.material.a1_per_n
    data = [measured()]
    held = identify(data, START, FREE, {"a1_per_n": Prior(a1, 1e-3 * a1)})["a1_per_n"]
    loose = identify(data, START, FREE)["a1_per_n"]
    assert held.used == pytest.approx(a1, rel=0.02)
    assert held.posterior_std <= 1e-3 * a1
    assert loose.used == pytest.approx(1.1 * a1, rel=0.05)
