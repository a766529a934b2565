"""Horizon control makes the tip of an arm unlike the model follow, in a closed loop of pure steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.support.tip_closed_loop import Truth, simulate
from model.inverse.static_map import StaticMap
from rig.tip_control import horizon
from rig.tip_control.estimation.estimator import TipEstimator
from rig.tip_control.horizon import HorizonControl, HorizonState
from rig.tip_control.interface import ControllerMeasurement, ReferenceTrajectory, SolveStatus
from rig.tip_control.kernels.arguments import ReferenceSamples, TimedSetPoints
from rig.tip_control.move_blocking import HORIZON, KNOTS
from tests.support.tip_control_task import ARM, LIMIT_PA, OTHER, RATE_PA_S, SETTINGS, circle

pytestmark = pytest.mark.slow


def test_the_sensitivities_of_the_prediction_are_those_of_finite_differences(static_map: StaticMap) -> None:
    controller, task = HorizonControl(SETTINGS), circle(1.0, 3.0)
    times, samples_s = SETTINGS.reference_times(2.0), np.array([1.0, 2.0])
    feed, samples = task.feedforward_pa(times), TimedSetPoints(samples_s, task.feedforward_pa(samples_s))
    reference = ReferenceSamples(times, task.position_m(times), feed, 0.0)
    motion = np.zeros((3, 4))
    motion[:, 0] = task.position_m(np.array([1.96]))[0]
    state = HorizonState(motion, 1.96, TipEstimator(static_map).start(), times, feed)
    sensitivities = controller.program(state, reference, samples, 2.0).prediction.sensitivities
    step_pa = 10.0
    for knot, valve in ((1, 0), (3, 1), (5, 2)):
        hat = np.interp(times, 2.0 + SETTINGS.frame_s * np.array(KNOTS), np.eye(len(KNOTS))[knot])
        change = step_pa * np.outer(hat, np.eye(3)[valve])
        up, down = (
            controller.program(state._replace(setpoint_pa=plan), reference, samples, 2.0).prediction.tips_m
            for plan in (feed + change, feed - change)
        )
        found = sensitivities[:, :, (knot - 1) * 3 + valve]
        np.testing.assert_allclose(found, (up - down) / (2 * step_pa), atol=1e-4 * np.abs(found).max())


def test_an_arm_unlike_the_model_follows_far_better_than_by_feedforward() -> None:
    task, truth = circle(1.0, 6.0), Truth(OTHER, np.array([1.03, 0.98, 1.0]))
    feedforward = simulate(SETTINGS, None, truth, task, seed=1)
    feedback = simulate(SETTINGS, HorizonControl(SETTINGS), truth, task, seed=1)
    assert feedforward.rms_m(3.0) > 1e-3
    assert feedback.rms_m(3.0) < 0.25e-3
    assert feedback.setpoint_pa.min() >= 0
    assert feedback.setpoint_pa.max() <= LIMIT_PA
    assert np.abs(np.diff(feedback.setpoint_pa, axis=0)).max() <= RATE_PA_S * 0.005 * (1 + 1e-9)
    # The innovations are not larger than the filter says: the NIS of three degrees of freedom has mean 3.
    nis = np.array([plan.nis for plan in feedback.plans[60:]])
    assert 0.5 < nis.mean() < 4.5


def test_an_arm_damped_more_than_stated_is_followed_near_its_first_mode() -> None:
    task = circle(3.0, 3.0, 0.008)
    truth = Truth(ARM.with_segment(material=replace(ARM.material, damping_s=0.018)), np.ones(3))
    assert simulate(SETTINGS, None, truth, task, seed=1).rms_m(1.0) > 4e-3
    assert simulate(SETTINGS, HorizonControl(SETTINGS), truth, task, seed=1).rms_m(1.0) < 0.5e-3


@pytest.mark.parametrize(
    ("frequency_hz", "radius_m", "seed"), [(0.25, 0.02, 2), (0.4, 0.02, 3), (0.5, 0.025, 4), (0.3, 0.03, 5)]
)
def test_an_unknown_load_on_the_tip_is_compensated(frequency_hz: float, radius_m: float, seed: int) -> None:
    task = circle(frequency_hz, 8.0, radius_m)
    rng = np.random.default_rng(seed)
    truth = Truth(OTHER, 1 + 0.03 * rng.standard_normal(3), payload_kg=0.05, payload_at_s=5.0)
    run = simulate(SETTINGS, HorizonControl(SETTINGS), truth, task, seed)
    off = np.linalg.norm(run.tip_m - run.reference_m, axis=1)
    assert off[run.times_s > 6.0].max() < 0.3e-3


def test_the_same_run_is_the_same_bit_for_bit() -> None:
    task, truth = circle(1.0, 1.5), Truth(OTHER, np.ones(3))
    first, second = (simulate(SETTINGS, HorizonControl(SETTINGS), truth, task, seed=4) for _ in range(2))
    np.testing.assert_array_equal(first.setpoint_pa, second.setpoint_pa)


def test_a_frame_without_a_tip_leaves_a_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    controller = HorizonControl(SETTINGS)
    times, feed = np.arange(0, 1, 1 / 30), np.full((30, 3), 3e4)
    tip = StaticMap.of(ARM, (0, 1, 2), LIMIT_PA).tips(feed)
    reference = ReferenceTrajectory(times, tip, np.zeros((30, 3)), feed, None)
    measured = ControllerMeasurement(
        -0.04, np.full(3, np.nan), np.eye(3), np.array([-0.1, 0.0]), feed[:2], feed[:2], 0.0
    )
    plan = controller.step(controller.start(), reference, measured)
    assert plan.status is SolveStatus.SOLVED
    np.testing.assert_allclose(plan.setpoint_pa, 3e4, atol=1.0)
    size = 3 * (len(KNOTS) - 1)
    cut_off = (np.full(size, np.nan), 0.0, -4, {"iterations": 200, "lam": np.zeros(6 * HORIZON)})
    monkeypatch.setattr(horizon.daqp, "solve", lambda *args, **options: cut_off)
    failed = controller.step(plan.state, reference, measured._replace(tip_m=tip[0] + 1e-3, time_s=-0.02))
    assert failed.status is SolveStatus.NOT_SOLVED
    np.testing.assert_allclose(failed.setpoint_pa, plan.setpoint_pa, atol=1.0)
