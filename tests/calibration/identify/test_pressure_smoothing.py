"""The pressures that a model is driven with: noise taken off, edges kept, and a density that noise does not spoil."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import model
from calibration.identify import Prior, Setup, identify
from calibration.identify.observations.pressure_smoothing import curve, noise_std, regression_calibrated, smoothed
from calibration.identify.prediction.tip_predictor import FINE_SUBSTEPS, SUBSTEPS, Predictor
from calibration.identify.simulated_experiments import MeasurementErrors, perform, plan

CYCLE_HZ, CAMERA_HZ = 200, 30
NOISE_PA = 45.0
START = Setup(model.Arm.paper())


def sine(time_s: np.ndarray) -> np.ndarray:
    ramp = np.clip(time_s, 0.0, 1.0)
    first = 0.35e5 * ramp**2 * (3 - 2 * ramp) + 0.25e5 * np.sin(1.4 * np.clip(time_s - 1, 0.0, None))
    return np.stack([first, np.zeros_like(first), np.zeros_like(first)], axis=1)


def test_noise_of_a_smooth_signal_is_estimated_and_removed() -> None:
    time_s = np.arange(0, 12, 1 / CYCLE_HZ)
    truth = sine(time_s)
    samples = truth + NOISE_PA * np.random.default_rng(5).standard_normal(truth.shape)
    assert noise_std(samples) == pytest.approx(np.full(3, NOISE_PA), rel=0.1)
    found, deviation = smoothed(samples)
    error = np.sqrt(((found - truth) ** 2).mean(axis=0))
    assert (error < 0.36 * NOISE_PA).all()
    # The stated deviation is of the size of the error.
    stated = np.sqrt((deviation**2).mean(axis=0))
    assert (error < 2 * stated).all()
    assert (error > 0.5 * stated).all()


def test_smoothing_keeps_amplitude_and_phase_of_a_motion() -> None:
    cycles_s = np.arange(0, 40, 1 / CYCLE_HZ)
    omega = 2 * np.pi * np.array([0.6, 0.9])
    truth = 2e4 * np.sin(np.outer(cycles_s, omega))
    rng = np.random.default_rng(3)
    found = np.mean([smoothed(truth + 2 * NOISE_PA * rng.standard_normal(truth.shape))[0] for _ in range(6)], axis=0)
    height = (found * truth).sum(axis=0) / (truth**2).sum(axis=0)
    ahead = 2e4 * np.cos(np.outer(cycles_s, omega))
    late_s = -(found * ahead).sum(axis=0) / (truth**2).sum(axis=0) / omega
    # Chance alone leaves 2e-5 and 5 us. A crest cut by a ten-thousandth is a tenth of a usual damping.
    assert height == pytest.approx(np.ones(2), abs=8e-5)
    assert late_s == pytest.approx(np.zeros(2), abs=2e-5)


def test_smoothing_is_as_accurate_at_the_ends_as_in_the_middle() -> None:
    time_s = np.arange(0, 8, 1 / CYCLE_HZ)
    truth = 2e4 * np.sin(2 * np.pi * np.outer(time_s, [0.6, 0.9]) + 0.7)
    rng = np.random.default_rng(4)
    courses = np.array([smoothed(truth + NOISE_PA * rng.standard_normal(truth.shape))[0] for _ in range(20)])
    bias = np.abs(courses.mean(axis=0) - truth)
    # The mean of twenty courses still has a fifth of their noise.
    assert bias[:40].max() < 0.6 * NOISE_PA
    assert bias[-40:].max() < 0.6 * NOISE_PA


def test_interpolation_keeps_crests_and_slopes() -> None:
    omega = 2 * np.pi * 1.0
    frames_s = np.arange(60) / CAMERA_HZ
    at_s = np.arange(2, 57, 0.125) / CAMERA_HZ + 0.004
    found, rate = curve(frames_s, np.sin(omega * frames_s)[:, None], at_s)
    # Straight lines lose 0.36 %.
    assert np.abs(found[:, 0] - np.sin(omega * at_s)).max() < 5e-4
    assert np.abs(rate[:, 0] - omega * np.cos(omega * at_s)).max() < 0.02 * omega


def test_extrapolation_is_linear() -> None:
    time_s = np.array([0.0, 1.0, 2.0])
    found, rate = curve(time_s, np.array([[1.0], [3.0], [5.0]]), np.array([-0.5, 2.5]))
    assert found[:, 0] == pytest.approx([0.0, 6.0])
    assert rate[:, 0] == pytest.approx([2.0, 2.0])
    assert curve(time_s[:1], np.array([[7.0]]), np.array([0.0, 0.2]))[0][:, 0] == pytest.approx([7.0, 7.0])


def test_smoothing_keeps_edges() -> None:
    samples = np.where(np.arange(600) < 300, 0.2e5, 0.5e5)[:, None]
    samples = samples + NOISE_PA * np.random.default_rng(6).standard_normal(samples.shape)
    found, _ = smoothed(samples)
    assert np.abs(found[:290] - 0.2e5).max() < 4 * NOISE_PA
    assert np.abs(found[310:] - 0.5e5).max() < 4 * NOISE_PA
    assert found[299, 0] < 0.25e5
    assert found[300, 0] > 0.45e5


@pytest.mark.slow
def test_pressure_noise_does_not_bias_the_density() -> None:
    arm = model.Arm.paper()
    truth = Setup(arm.with_segment(material=replace(arm.material, damping_s=0.01, density_kg_m3=1100.0)))
    cycles_s, frames_s = np.arange(0, 9, 1 / CYCLE_HZ), np.arange(0, 9, 1 / CAMERA_HZ)
    planned = plan(
        "sine", sine(frames_s), period_s=1 / CAMERA_HZ, errors=MeasurementErrors((3e-5, 3e-5, 3e-5), 0.0, 0.0)
    )
    rng = np.random.default_rng(1)
    tip = Predictor(planned, 8, extrapolated=True)(truth) + 3e-5 * rng.standard_normal((len(planned), 3))
    samples = sine(cycles_s) + 3 * NOISE_PA * rng.standard_normal((len(cycles_s), 3))
    smooth, std = smoothed(samples)
    noise = np.tile(std[:1], (len(frames_s), 1))
    data = replace(planned, tip_m=tip, pressure_pa=curve(cycles_s, smooth, frames_s)[0], pressure_std_pa=noise)

    free, priors = ["density_kg_m3", "sensor_offsets"], {"sensor_offsets": Prior(0.0, 200.0)}
    density = identify([data], truth, free, priors)["density_kg_m3"]
    assert density.std is not None
    assert abs(density.used - 1100.0) < 3 * density.std


def test_fine_steps_do_not_slow_the_arms_own_oscillation() -> None:
    pressure = np.zeros((40, 3))
    pressure[3:, 0] = 0.2e5
    step = plan("step", pressure, period_s=1 / CAMERA_HZ)
    truth = Predictor(step, 40)(Setup(model.Arm.paper()))
    coarse, fine = (
        np.linalg.norm(predictor(Setup(model.Arm.paper())) - truth, axis=1).max()
        for predictor in (Predictor(step, SUBSTEPS), Predictor(step, FINE_SUBSTEPS, extrapolated=True))
    )
    assert fine < 0.35 * coarse


@pytest.mark.parametrize(
    ("hertz", "amplitude_pa", "true_s", "share"), [(2.0, 0.15e5, 0.01, 2e-4), (5.0, 0.03e5, 0.004, 2e-3)]
)
def test_extrapolated_steps_do_not_change_the_damping_of_a_fast_motion(
    hertz: float, amplitude_pa: float, true_s: float, share: float
) -> None:
    time_s = np.arange(45) / CAMERA_HZ
    sine = 0.3e5 + amplitude_pa * np.sin(2 * np.pi * hertz * time_s)
    pressure = np.stack([sine, 0 * time_s, 0 * time_s], axis=1)
    fast = plan("fast", pressure, period_s=1 / CAMERA_HZ)

    def tips(damping_s: float, substeps: int, extrapolated: bool = False) -> np.ndarray:
        arm = model.Arm.paper()
        setup = Setup(arm.with_segment(material=replace(arm.material, damping_s=damping_s)))
        return Predictor(fast, substeps, extrapolated)(setup)

    truth = tips(true_s, 32, extrapolated=True)
    by_damping = (tips(1.01 * true_s, 32) - tips(true_s, 32)) / 0.01

    def relative_error_of_damping(found: np.ndarray) -> float:
        return float(((found - truth) * by_damping).sum() / (by_damping**2).sum())

    plain = relative_error_of_damping(tips(true_s, 2 * FINE_SUBSTEPS))
    extrapolated = relative_error_of_damping(tips(true_s, FINE_SUBSTEPS, extrapolated=True))
    assert abs(plain) > 5e-4
    assert abs(extrapolated) < share


def test_chambers_of_one_valve_differ_by_a_constant_once_their_noise_is_known() -> None:
    time_s, rng = np.arange(0, 12, 1 / CYCLE_HZ), np.random.default_rng(6)
    offset = np.array([0.0, 20.0, 90.0])
    truth = np.stack([np.zeros_like(time_s), *2 * [0.3e5 + 0.25e5 * np.sin(2 * time_s)]], axis=1) + offset
    noise = np.full(truth.shape, NOISE_PA)
    found = regression_calibrated(truth + NOISE_PA * rng.standard_normal(truth.shape), noise)
    apart = found[:, 2] - found[:, 1]
    assert apart.std() < 0.25 * NOISE_PA
    assert apart.mean() == pytest.approx(70.0, abs=3 * NOISE_PA * np.sqrt(2 / len(time_s)))


def test_pressures_that_vary_on_their_own_stay_as_they_are() -> None:
    time_s, rng = np.arange(0, 12, 1 / CYCLE_HZ), np.random.default_rng(7)
    samples = 2e4 * np.sin(np.outer(time_s, [1.0, 2.3, 3.1])) + NOISE_PA * rng.standard_normal((len(time_s), 3))
    found = regression_calibrated(samples, np.full(samples.shape, NOISE_PA))
    assert np.abs(found - samples).max() < 1e-3 * NOISE_PA * 3 * np.sqrt(2e4 / NOISE_PA)


def test_pressures_without_noise_stay_as_they_are() -> None:
    samples = np.stack([np.linspace(0.0, 1e4, 50), np.full(50, 3e3)], axis=1)
    found = regression_calibrated(samples, np.zeros(samples.shape))
    assert found == pytest.approx(samples, abs=1e-6)


def test_noise_of_two_chambers_of_one_valve_does_not_move_their_places() -> None:
    """Uncalibrated, the fit reduces the response to a difference of pressures that is noise alone."""
    noise_pa, rng = 80.0, np.random.default_rng(8)
    frames_s = np.arange(0, 20, 1 / CAMERA_HZ)
    common = 0.35e5 - 0.3e5 * np.cos(0.8 * np.pi * frames_s)
    true_pa = np.stack([np.full_like(common, 0.1e5), common, common], axis=1)
    errors = MeasurementErrors((3e-6, 3e-6, 3e-6), 0.0, 0.0, rotation_rad=1e-4)
    poses = perform(plan("sine", true_pa, errors=errors), START, rng, errors)
    std = np.full(true_pa.shape, noise_pa)
    measured = true_pa + noise_pa * rng.standard_normal(true_pa.shape)
    calibrated = regression_calibrated(measured, std)
    turns = [f"actuator_{n}_turn_rad" for n in (2, 3)]
    priors = {name: Prior(0.0, 0.03) for name in turns} | {name: Prior(0.0, 2e-3) for name in ("base_x_m", "tool_x_m")}
    priors |= {"circle_radius_m": Prior(START.arm.geometry.actuator_xy_m[0][0], 5e-4)}

    def errors_in_stds(pressure_pa: np.ndarray) -> np.ndarray:
        data = replace(poses, pressure_pa=pressure_pa, pressure_std_pa=std)
        fit = identify([data], START, tuple(priors), priors=priors)
        stds = np.array([fit[name].posterior_std for name in turns])
        return np.abs([fit[name].used for name in turns]) / stds

    assert (errors_in_stds(measured) > 3.0).all()
    assert (errors_in_stds(calibrated) < 2.0).all()
