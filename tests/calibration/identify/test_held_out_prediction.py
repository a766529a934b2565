"""Prediction intervals of held-out runs hold as often as they say, and each of their sources counts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import model
from calibration.identify import Prior, Setup, identify, split_at
from calibration.identify.fitting.held_out_prediction import Prediction, predict
from calibration.identify.fitting.results import Fit
from calibration.identify.observations.poses import Poses
from calibration.identify.simulated_experiments import MeasurementErrors, perform, plan

FREE = ("law", "rpe_per_bar", "base_x_m", "base_z_m", "sensor_offsets")
ERRORS = MeasurementErrors((1e-4, 1e-4, 1e-4), 50.0, 200.0)
PRIORS = {"sensor_offsets": Prior(0.0, ERRORS.offset_pa)}
START = Setup(model.Arm.paper())
RAMP = np.linspace(0.15e5, 0.65e5, 6)[:, None]
PLANNED = [plan("one", RAMP * [1, 0, 0], errors=ERRORS), plan("two", RAMP * [0, 1, 1], errors=ERRORS)]


def predicted(seed: int, errors: MeasurementErrors = ERRORS) -> tuple[Fit, Prediction]:
    """A fit to two ramps, and its prediction of ten poses with three pressed chambers."""
    rng = np.random.default_rng(seed)
    pressures = rng.uniform(0.05e5, 0.6e5, (10, 3))
    fit = identify([perform(one, START, rng, errors) for one in PLANNED], START, FREE, PRIORS)
    return fit, predict(fit, perform(plan("new", pressures, errors=errors), START, rng, errors))


@pytest.mark.slow
def test_95_percent_of_the_prediction_intervals_hold_on_an_arm_that_obeys_the_model() -> None:
    shares = np.array([predicted(seed)[1].share_in_95 for seed in range(16)])
    # The poses of one run share the errors of the parameters and offsets: 160 tips count as about 30.
    assert 0.91 < shares[:, :3].mean() < 0.985
    assert 0.90 < shares[:, 3].mean() < 0.99


def test_parameters_offsets_tip_and_model_error_widen_the_intervals() -> None:
    fit, found = predicted(0)
    new = replace(
        plan("again", found.predicted_m * 0 + 0.4e5, errors=ERRORS), tip_m=found.measured_m, wrench=np.zeros((10, 6))
    )
    whole = predict(fit, new).std_m
    exact = replace(fit, covariance=0 * fit.covariance)
    assert predict(exact, new).std_m < 0.97 * whole
    noise = replace(fit.noise, extra={"tip": 1e-3})
    rough = replace(fit, objective=replace(fit.objective, noise=noise))
    assert predict(rough, new).std_m ** 2 > whole**2 + 2.9e-6
    precise = replace(new, covariance_m2=1e-14 * np.tile(np.eye(3), (10, 1, 1)))
    assert predict(fit, precise).std_m ** 2 < whole**2 - 2.9e-8


def test_the_rest_of_a_split_run_has_the_offsets_of_its_beginning() -> None:
    rng = np.random.default_rng(1)
    errors = replace(ERRORS, offset_pa=1000.0)
    parts = [split_at(perform(one, START, rng, errors), 4.0) for one in PLANNED]
    fit = identify([before for before, _ in parts], START, FREE, {"sensor_offsets": Prior(0.0, 1000.0)})
    same = predict(fit, parts[1][1])
    stranger = predict(fit, replace(parts[1][1], source="another run"))
    assert same.std_m < 0.5 * stranger.std_m
    assert same.rms_m < stranger.rms_m
    assert same.share_in_95[:3].mean() > 0.6
    assert np.isfinite(same.interval_m).all()


def test_a_frame_without_a_tip_is_predicted_and_does_not_count() -> None:
    fit, found = predicted(2)
    poses: Poses = plan("blind", np.full((10, 3), 0.3e5), errors=ERRORS)
    blind = predict(fit, replace(poses, tip_m=np.where(np.arange(10)[:, None] < 9, np.nan, found.measured_m)))
    assert np.isfinite(blind.interval_m).all()
    assert np.isfinite(blind.share_in_95).all()
    assert np.isnan(predict(fit, poses).share_in_95).all()
