"""The slopes that an identification climbs by are those of what it predicts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import model
from calibration.identify import Setup
from calibration.identify.prediction.forward_model import ForwardModel
from calibration.identify.prediction.tip_predictor import Predictor
from calibration.identify.simulated_experiments import plan
from model.actuation import ActuationLaw, PressureSum, Proportional
from tests.support.finite_differences import forward_of

BAR = 1e5
FREE = ("law", "rpe_per_bar", "density_kg_m3", "damping_s", "cap_mass_kg", "length_m", "base", "tool_z_m",
        "actuator_1_turn_rad", "sensor_gains", "sensor_offsets")  # fmt: skip
RESTING = plan("rest", np.array([[0.3, 0.1, 0.5], [0.55, 0.2, 0.05], [0.0, 0.0, 0.0]]) * BAR, np.array([0.0, 0.3, 0.1]))
MOVING = plan(
    "motion", np.stack([0.3 + 0.2 * np.sin(0.3 * np.arange(7)), 0.1 + np.zeros(7), np.zeros(7)], axis=1) * BAR,
    period_s=1 / 30,
)  # fmt: skip


def start() -> Setup:
    arm = replace(model.Arm.paper(), rod_weight=True)
    return Setup(arm.with_segment(material=replace(arm.material, damping_s=0.01)), tool_offset_m=(0.0, 0.01, 0.03))


def differences(forward: ForwardModel, theta: NDArray[np.float64], i: int, run: int) -> NDArray[np.float64]:
    """Derivative of a run's predicted tips by an unknown in spans: central differences of three sizes, extrapolated."""

    def tips(by: float) -> NDArray[np.float64]:
        there = theta.copy()
        there[i] += by * forward.span[i]
        return forward.predicted(there)[run]

    one, two, four = ((tips(h) - tips(-h)) / (2 * h) for h in (2e-3, 4e-3, 8e-3))
    return (64 * one - 20 * two + four) / 45


def test_slopes_equal_finite_differences_static_and_dynamic(monkeypatch: pytest.MonkeyPatch) -> None:
    # What Newton's method leaves of a step differs from one parameter to the next: here it leaves nothing.
    monkeypatch.setattr("model.dynamics.TOLERANCE_IN_MOTION", 1e-7)
    forward = forward_of([RESTING, MOVING], start(), FREE, substeps=8)
    theta = forward.first + np.random.default_rng(4).uniform(-0.05, 0.05, len(forward.unknowns)) * forward.span
    found = [slope * forward.span for slope in forward.slopes(theta)]
    for i, unknown in enumerate(forward.unknowns):
        for run, tolerance in ((0, 2e-7), (1, 2e-6)):
            expected = differences(forward, theta, i, run)
            assert found[run][:, :, i] == pytest.approx(expected, rel=1e-4, abs=tolerance), unknown.name


def test_slopes_at_a_bound_use_a_step_inwards() -> None:
    material = replace(start().arm.material, shear_ratio=5.0)
    forward = forward_of([RESTING], replace(start(), arm=start().arm.with_segment(material=material)), ["shear_ratio"])
    theta = forward.first
    inside = [forward.predicted(theta - by * forward.span)[0] for by in (2e-3, 1e-3, 0.0)]
    expected = (3 * inside[2] - 4 * inside[1] + inside[0]) / 2e-3
    found = (forward.slopes(theta)[0] * forward.span)[:, :, 0]
    assert np.abs(found).max() > 1e-6
    assert found == pytest.approx(expected, rel=1e-2, abs=1e-7)


PULLED = replace(
    MOVING, wrench=np.array([[0.3, -0.2, 0.4, 0.004, -0.002, 0.003]]) * np.cos(0.2 * np.arange(7))[:, None]
)


@pytest.mark.parametrize("actuation", [Proportional(), PressureSum(0.2)])
def test_dynamic_slopes_equal_finite_differences_under_a_wrench(
    monkeypatch: pytest.MonkeyPatch, actuation: ActuationLaw
) -> None:
    monkeypatch.setattr("model.dynamics.TOLERANCE_IN_MOTION", 1e-7)
    free = ("law", "tool_x_m", "base_rx_rad")
    forward = forward_of([PULLED], replace(start(), arm=replace(start().arm, actuation=actuation)), free)
    found = forward.slopes(forward.first)[0] * forward.span
    assert np.abs(found).max(axis=(0, 1)).min() > 1e-4
    for i in range(len(forward.unknowns)):
        assert found[:, :, i] == pytest.approx(differences(forward, forward.first, i, 0), rel=1e-4, abs=2e-6)


def test_a_slow_motion_under_a_wrench_equals_a_sequence_of_equilibria() -> None:
    slow = Predictor(replace(PULLED, period_s=30.0))(start())
    still = Predictor(replace(PULLED, period_s=0.0))(start())
    assert np.linalg.norm(slow - Predictor(MOVING)(start()), axis=1).min() > 1e-3
    assert slow == pytest.approx(still, abs=1e-5)


def test_pressure_noise_is_propagated_to_the_measured_point_under_a_wrench() -> None:
    turned = replace(start(), base_rotation_rad=(0.0, 0.0, 1.5), tool_offset_m=(0.0, 0.0, 0.2))
    poses = replace(PULLED, period_s=0.0, pressure_std_pa=np.full((7, 3), 30.0))
    often = poses.only(np.repeat(np.arange(7), 1000))
    noise = 30.0 * np.random.default_rng(2).standard_normal((7000, 3))
    tips = Predictor(replace(often, pressure_pa=often.pressure_pa + noise))(turned).reshape(7, 1000, 3)
    for found, seen in zip(Predictor(poses).pressure_covariance(turned), tips, strict=True):
        assert np.linalg.norm(np.cov(seen.T) - found) < 0.15 * np.linalg.norm(found)
