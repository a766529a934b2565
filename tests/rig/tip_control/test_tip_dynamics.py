"""The first mode of the tip follows the rod model, and its steps are matrix exponentials."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from model.dynamics import Dynamics
from model.inverse.static_map import StaticMap
from rig.tip_control.estimation.estimator import tip_map_of
from rig.tip_control.kernels.arguments import TimedSetPoints
from rig.tip_control.kernels.prediction import advanced
from rig.tip_control.tip_dynamics import TipDynamics
from tests.support.tip_control_task import ARM, LIMIT_PA


def test_the_first_mode_follows_the_rod_model(static_map: StaticMap) -> None:
    times = 0.005 * np.arange(400)
    pressure = 3e4 + 1e4 * np.stack([np.sin(2 * np.pi * times + shift) for shift in (0, 2, 4)], axis=1)
    dynamics = Dynamics(ARM, 0.005)
    dynamics.start(pressure[0])
    rod = dynamics.run(pressure[1:]).tip_m[200:]
    mode = TipDynamics.of(ARM, LIMIT_PA)
    drive = static_map.tips(pressure)
    tips = mode.advance(np.stack([drive[0], np.zeros(3)]), drive, 0.005)[201:, 0]
    quasi_static = np.sqrt(np.mean(np.sum((drive[201:] - rod) ** 2, axis=1)))
    error = np.sqrt(np.mean(np.sum((tips - rod) ** 2, axis=1)))
    assert error < 0.3 * quasi_static


MODES = TipDynamics(np.array([41.0, 41.0, 97.0]), np.array([0.01, 2 / 41.0, 0.03]))
"""Below, at and above critical damping."""


@pytest.mark.parametrize("step_s", [1e-4, 1 / 60, 0.3])
def test_a_step_of_the_modes_is_the_matrix_exponential(step_s: float) -> None:
    transition, first, last = MODES.step(step_s)
    for axis, (omega, tau) in enumerate(zip(MODES.omega_rad_s, MODES.tau_s, strict=True)):
        square = omega**2
        system = np.array([[0, 1, 0, 0], [-square, -square * tau, square, 0], [0, 0, 0, 1 / step_s], [0, 0, 0, 0]])
        step = expm(step_s * system)
        scale = np.array([1.0, omega])  # velocities are compared with those of the mode
        np.testing.assert_allclose(transition[axis] / scale[:, None], step[:2, :2] / scale[:, None], atol=1e-8)
        np.testing.assert_allclose(first[axis] / scale, (step[:2, 2] - step[:2, 3]) / scale, atol=1e-8)
        np.testing.assert_allclose(last[axis] / scale, step[:2, 3] / scale, atol=1e-8)


def test_the_sensitivity_of_the_motion_by_the_retardation_time_is_that_of_finite_differences(
    static_map: StaticMap,
) -> None:
    tip_map, times = tip_map_of(static_map), np.linspace(0.0, 2.0, 401)
    pressure = 3e4 + 1e4 * np.stack([np.sin(2 * np.pi * times**2 + shift) for shift in (0, 2, 4)], axis=1)
    mode, samples = TipDynamics.of(ARM, LIMIT_PA), TimedSetPoints(times, pressure)

    def motion(tau_s: np.ndarray) -> np.ndarray:
        rest, _ = advanced(tip_map, mode.omega_rad_s, tau_s, np.zeros((3, 4)), 0.0, 0.0, 0, 0.0, samples)
        found: np.ndarray = advanced(tip_map, mode.omega_rad_s, tau_s, rest, 0.0, 1.8, 1800, 0.0, samples)[0]
        return found

    change_s = 1e-6
    difference = (motion(mode.tau_s + change_s) - motion(mode.tau_s - change_s)) / (2 * change_s)
    found = motion(mode.tau_s)
    # Its drive, the velocity, is linear within a step.
    np.testing.assert_allclose(found[:, 2], difference[:, 0], atol=2e-3 * np.abs(difference[:, 0]).max())
    np.testing.assert_allclose(found[:, 3], difference[:, 1], atol=2e-3 * np.abs(difference[:, 1]).max())
