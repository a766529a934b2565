"""Courses of the pressures that the sensors do not resolve are an error that all frames of a motion share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import model
from calibration.identify import Poses, Prior, Setup, identify
from calibration.identify.likelihood import Weights
from calibration.identify.pressure_smoothing import regression_calibrated
from calibration.identify.simulated_experiments import MeasurementErrors, plan
from calibration.identify.tip_predictor import Predictor
from calibration.identify.unresolved_pressures import unresolved_courses

NOISE_PA, CAMERA_HZ = 17.0, 30
TIP_M = (4e-6, 3e-5, 1.5e-6)


def one_moving_chamber(frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Pressures (K, 3) [Pa] and their rates (K, 3) [Pa/s]: one chamber moves, two are vented."""
    time_s = np.arange(frames) / CAMERA_HZ
    value, rate = 0.35e5 + 0.25e5 * np.sin(time_s), 0.25e5 * np.cos(time_s)
    nothing = np.zeros(frames)
    return np.stack([value, nothing, nothing], axis=1), np.stack([rate, nothing, nothing], axis=1)


def explained(course_pa: np.ndarray, unresolved_pa: np.ndarray) -> float:
    """Distance of the coefficients from zero, in their standard deviations, that give a course (K, N) best."""
    columns = unresolved_pa.reshape(-1, unresolved_pa.shape[2])
    found, *_ = np.linalg.lstsq(columns, course_pa.ravel(), rcond=None)
    assert columns @ found == pytest.approx(course_pa.ravel(), abs=0.2)
    return float(np.linalg.norm(found))


def courses_of(samples: np.ndarray, rate: np.ndarray) -> np.ndarray:
    calibrated = regression_calibrated(samples, np.full(samples.shape, NOISE_PA))
    return unresolved_courses(calibrated.pressure_pa, rate, calibrated.unresolved)


def test_a_vented_chamber_may_follow_pressure_and_rate_of_another_below_the_noise() -> None:
    pressure, rate = one_moving_chamber(960)
    samples = pressure + NOISE_PA * np.random.default_rng(1).standard_normal(pressure.shape)
    unresolved = courses_of(samples, rate)
    # Two pascals in and out of step with the moving chamber; a constant part is an offset of the sensor.
    in_step, out_of_step = ((part[:, 0] - part[:, 0].mean()) / 0.25e5 for part in (pressure, rate))
    for course in (in_step, out_of_step, in_step**2 - (in_step**2).mean()):
        vented = 2.0 * course[:, None] * np.array([0.0, 1.0, 1.0])
        assert explained(vented, unresolved) < 1
        assert explained(10 * vented, unresolved) > 2


def test_more_frames_resolve_smaller_courses() -> None:
    sizes = []
    for frames in (240, 3840):
        pressure, rate = one_moving_chamber(frames)
        noise_pa = NOISE_PA * np.eye(3)[:, 1:]
        found = unresolved_courses(pressure, rate, noise_pa)
        sizes.append(np.sqrt((found[:, 1] ** 2).mean(axis=0)).max())
    assert sizes[0] == pytest.approx(NOISE_PA * (2 / 240) ** 0.25)
    assert sizes[0] / sizes[1] == pytest.approx(2.0)


def test_pressures_that_move_on_their_own_have_no_unresolved_course() -> None:
    time_s = np.arange(960) / CAMERA_HZ
    samples = 0.3e5 + 0.2e5 * np.sin(np.outer(time_s, [1.0, 1.7, 2.3]))
    assert courses_of(samples, np.gradient(samples, time_s, axis=0)).shape[2] == 0


def test_whitened_residuals_have_the_stated_shared_errors_taken_out() -> None:
    rng = np.random.default_rng(2)
    scatter = rng.standard_normal((8, 3, 3))
    covariance, common = scatter @ np.swapaxes(scatter, 1, 2) + np.eye(3), rng.standard_normal((8, 3, 2))
    weights = Weights.of(covariance, np.ones((8, 3), np.bool_), common)
    whole = np.zeros((24, 24))
    for k in range(8):
        whole[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = covariance[k]
    whole += common.reshape(24, 2) @ common.reshape(24, 2).T
    residual = rng.standard_normal((8, 3))
    expected = residual.ravel() @ np.linalg.solve(whole, residual.ravel())
    assert (weights.whitened(residual) ** 2).sum() == pytest.approx(expected)
    assert weights.log_det == pytest.approx(np.linalg.slogdet(2 * np.pi * whole)[1])


def vented_courses(seed: int) -> tuple[Poses, Setup]:
    """A fine camera sees an arm of which the vented chambers follow the moving one by pascals."""
    arm = model.Arm.paper()
    truth = Setup(arm.with_segment(material=replace(arm.material, damping_s=0.01)))
    pressure, rate = one_moving_chamber(300)
    planned = plan("sine", pressure, period_s=1 / CAMERA_HZ, errors=MeasurementErrors(TIP_M, NOISE_PA, 0.0))
    rng = np.random.default_rng(seed)
    vented = np.outer(rng.normal(0, 3) * rate[:, 0] / 0.25e5 + rng.normal(0, 3) * pressure[:, 0] / 0.25e5, [0, 1, 1])
    tip = Predictor(replace(planned, pressure_pa=pressure + vented), 8, extrapolated=True)(truth)
    calibrated = regression_calibrated(
        pressure + NOISE_PA * rng.standard_normal(pressure.shape), np.full(pressure.shape, NOISE_PA)
    )
    poses = replace(
        planned,
        tip_m=tip + rng.standard_normal(tip.shape) * TIP_M,
        pressure_mixing=calibrated.mixing,
        unresolved_pa=unresolved_courses(pressure, rate, calibrated.unresolved),
    )
    return poses, truth


@pytest.mark.slow
def test_error_bars_hold_where_vented_chambers_follow_below_the_noise() -> None:
    z: dict[bool, list[float]] = {True: [], False: []}
    for seed in range(4):
        poses, truth = vented_courses(seed)
        for stated in z:
            data = poses if stated else replace(poses, unresolved_pa=None)
            free = ["a1_per_n", "rpe_per_bar", "damping_s", "sensor_offsets"]
            fit = identify([data], truth, free, {"sensor_offsets": Prior(0.0, 500.0)})
            for name, true in (("a1_per_n", truth.arm.material.a1_per_n), ("damping_s", 0.01)):
                estimate = fit[name]
                if estimate.std is not None:
                    z[stated].append((estimate.used - true) / estimate.std)
    assert np.abs(z[True]).max() < 3
    assert np.abs(z[False]).max() > 4
