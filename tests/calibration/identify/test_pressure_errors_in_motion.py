"""Errors of the pressures move a model in motion more at the frequencies of its modes than at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calibration.identify import Poses, Setup, named
from calibration.identify.least_squares import LeastSquaresProblem
from calibration.identify.likelihood import whitened
from calibration.identify.simulated_experiments import MeasurementErrors, plan
from rig.config.arm_model import model_arm
from rig.config.loader import load

CAMERA_HZ, FRAMES, DRAWS = 30, 180, 24
ERRORS = MeasurementErrors(tip_m=(2e-4, 2e-4, 2e-4), pressure_pa=150.0, offset_pa=0.0)


def driven_near_the_first_mode(damping_s: float = 0.01) -> tuple[Poses, Setup]:
    """A bent arm that shakes at 5 Hz, with tips where the model predicts them."""
    arm = model_arm(load("mock"))
    setup = Setup(arm.with_segment(material=replace(arm.material, damping_s=damping_s)))
    phase = 2 * np.pi * 5.0 * np.arange(FRAMES)[:, None] / CAMERA_HZ
    pressure = 1e5 * (np.array([0.35, 0.1, 0.1]) + np.array([0.03, 0.0, 0.0]) * np.sin(phase))
    planned = plan("shaken", pressure, period_s=1 / CAMERA_HZ, errors=ERRORS)
    return replace(planned, tip_m=problem_of(planned, setup).predicted(np.zeros(1))[0]), setup


def problem_of(poses: Poses, setup: Setup) -> LeastSquaresProblem:
    return LeastSquaresProblem([poses], setup, named(["damping_s"], 3), substeps=4)


def gaps_by_noise(poses: Poses, setup: Setup) -> list[np.ndarray]:
    """Measured minus predicted where the measured pressures and tips err as stated."""
    rng, found = np.random.default_rng(4), []
    for _ in range(DRAWS):
        pressure = poses.pressure_pa + ERRORS.pressure_pa * rng.standard_normal(poses.pressure_pa.shape)
        noisy = replace(poses, pressure_pa=pressure)
        of_tips = np.array(ERRORS.tip_m) * rng.standard_normal((FRAMES, 3))
        found.append(problem_of(noisy, setup).gaps(np.zeros(1))[0] + of_tips)
    return found


def test_whitened_residuals_have_unit_power_at_every_frequency_of_a_motion() -> None:
    poses, setup = driven_near_the_first_mode()
    problem = problem_of(poses, setup)
    (weights,), _ = problem.weights(np.zeros(1), 0.0)
    rows = np.array([whitened(poses, gap, weights) for gap in gaps_by_noise(poses, setup)])
    power = (np.abs(np.fft.rfft(rows, axis=1, norm="ortho")) ** 2).mean(axis=0)
    hertz = np.fft.rfftfreq(FRAMES, 1 / CAMERA_HZ)
    for low, high in ((0, 3), (3, 5), (5, 7), (7, 9)):
        band = power[(hertz >= low) & (hertz < high)].mean(axis=0)
        np.testing.assert_allclose(band, 1.0, atol=0.2, err_msg=f"{low} to {high} Hz")


@pytest.mark.parametrize("damping_s", [0.005, 0.01])
def test_errors_of_a_damping_are_as_large_as_its_bar(damping_s: float) -> None:
    poses, setup = driven_near_the_first_mode(damping_s)
    problem, z = problem_of(poses, setup), np.zeros(1)
    (weights,), _ = problem.weights(z, 0.0)
    (slope,), _ = problem.whitened_slopes(z, masked=False)
    column = slope.ravel()
    bar = 1 / np.linalg.norm(column)
    errors = [column @ whitened(poses, gap, weights).ravel() * bar**2 for gap in gaps_by_noise(poses, setup)]
    # The scatter of 24 draws is known to 15 %.
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(bar, rel=0.3)
