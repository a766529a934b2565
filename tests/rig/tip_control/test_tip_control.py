"""Tip control as pure steps: maps, estimator, quadratic program, plan follower and closed loop."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

import model
from benchmarks.tip_closed_loop import Task, Truth, simulate
from model.dynamics import Dynamics
from model.inverse.static_map import LARGEST_PAYLOAD_KG, StaticMap
from model.statics import statics
from rig.tip_control import horizon
from rig.tip_control.estimation.estimator import TipEstimator
from rig.tip_control.horizon import HorizonControl, HorizonState
from rig.tip_control.interface import ControllerMeasurement, ReferenceTrajectory, SolveStatus, TipControlSettings
from rig.tip_control.kernels.arguments import ReferenceSamples, TimedSetPoints
from rig.tip_control.move_blocking import HORIZON, KNOTS
from rig.tip_control.plan_follower import LONGEST_S, PlanFollower, SetPointSource
from rig.tip_control.registry import CONTROLLERS, UnknownControllerError, controller_class
from rig.tip_control.tip_dynamics import TipDynamics
from runs.interpolation import interpolated

LIMIT_PA, RATE_PA_S = 0.7e5, 1e5


def _arm() -> model.Arm:
    arm = model.Arm.paper()
    return replace(arm, material=replace(arm.material, damping_s=0.01))


ARM = _arm()
SETTINGS = TipControlSettings(ARM, (0, 1, 2), LIMIT_PA, RATE_PA_S, 1 / 30, 0.04, 0.015)
OTHER = replace(ARM, material=replace(ARM.material, a1_per_n=0.0077, rpe_per_bar=0.0515, density_kg_m3=1130.0))


@pytest.fixture(scope="module")
def static_map() -> StaticMap:
    return StaticMap.of(ARM, (0, 1, 2), LIMIT_PA)


def _task(frequency_hz: float, duration_s: float, radius_m: float = 0.015) -> Task:
    """A circle from rest on; its feed-forward is that of the first-mode model."""
    chart, dynamics = StaticMap.of(ARM, (0, 1, 2), LIMIT_PA), TipDynamics.of(ARM, LIMIT_PA)
    times = np.arange(0.0, duration_s + 2.0, 0.005)
    turns = 2 * np.pi * frequency_hz * np.where(times < 1, 0.5 * times**2, times - 0.5)
    position = np.stack([radius_m * np.cos(turns), radius_m * np.sin(turns), np.full_like(turns, 0.19)], axis=1)
    velocity = np.gradient(position, 0.005, axis=0)
    drive = position + dynamics.tau_s * velocity + np.gradient(velocity, 0.005, axis=0) / dynamics.omega_rad_s**2
    feed = chart.inverse(drive, np.full(3, 3e4))

    def at(values: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        return lambda times_s: interpolated(times_s, times, values)

    return Task(duration_s, at(position), at(velocity), at(feed), 1 / frequency_hz)


def test_the_static_map_is_the_rod_model(static_map: StaticMap) -> None:
    pressures = np.random.default_rng(3).uniform(0, LIMIT_PA, (20, 3))
    hung = model.Loads(tip_force_n=0.03 * np.array(ARM.gravity_m_s2))
    rod = [statics(ARM, p, hung, doubt_units=False).tip_m for p in pressures]
    np.testing.assert_allclose(static_map.tips(pressures, 0.03), rod, atol=1e-5)


def test_points_without_a_target_keep_the_pressures_that_they_start_from(static_map: StaticMap) -> None:
    start = np.array([[1e4, 3e4, 2e4], [2e4, 2e4, 4e4]])
    target = np.array([static_map.tips(start[1:])[0], np.full(3, np.nan)])
    found = static_map.inverse(target, start)
    np.testing.assert_allclose(found[0], start[1], atol=10)
    np.testing.assert_array_equal(found[1], start[1])


@pytest.mark.parametrize("name", ["static-inverse", "inverse-integral"])
def test_the_plans_of_the_baselines_continue_with_the_feed_forward_beyond_the_end_of_the_path(name: str) -> None:
    controller, task = controller_class(name)(SETTINGS), _task(0.5, 2.0)
    times = SETTINGS.reference_times(1.0)
    over = (times > times[15])[:, None]
    position, velocity = (np.where(over, np.nan, values(times)) for values in (task.position_m, task.velocity_m_s))
    reference = ReferenceTrajectory(times, position, velocity, task.feedforward_pa(times), None)
    tip = task.position_m(np.array([0.96]))[0]
    measured = ControllerMeasurement(
        0.96, tip, 1e-8 * np.eye(3), np.array([0.9, 1.0]), np.zeros((2, 3)), np.zeros((2, 3)), 1.0
    )
    plan = controller.step(controller.start(), reference, measured)
    np.testing.assert_allclose(plan.setpoint_pa[20:], reference.feedforward_pa[20:])


def test_the_slopes_of_the_static_map_are_those_of_finite_differences(static_map: StaticMap) -> None:
    pressure = np.array([[2e4, 3e4, 4e4]])
    numeric = [
        (static_map.tips(pressure + step) - static_map.tips(pressure - step))[0] / 20.0 for step in 10.0 * np.eye(3)
    ]
    np.testing.assert_allclose(
        static_map.combined_slopes(pressure, static_map.payload_terms(0.0)[0])[1][0], np.array(numeric).T, rtol=1e-6
    )
    by_payload = (static_map.tips(pressure, 0.021) - static_map.tips(pressure, 0.019))[0] / 0.002
    np.testing.assert_allclose(static_map.by_payload(pressure[0], 0.02), by_payload, rtol=1e-5)


def test_the_inverse_is_the_nearest_point_within_the_limits(static_map: StaticMap) -> None:
    inside, outside = static_map.tips(np.array([[1e4, 3e4, 5e4]])), np.array([[0.0, 0.0, 0.15]])
    found = static_map.inverse(np.concatenate([inside, outside]), np.full(3, 2e4))
    np.testing.assert_allclose(found[0], [1e4, 3e4, 5e4], atol=1.0)
    grid = np.stack(np.meshgrid(*[np.linspace(0, LIMIT_PA, 15)] * 3), axis=-1).reshape(-1, 3)
    nearest = np.linalg.norm(static_map.tips(grid) - outside, axis=1).min()
    assert np.linalg.norm(static_map.tips(found[1:]) - outside) <= nearest + 1e-9
    assert (found >= 0).all()
    assert (found <= LIMIT_PA).all()


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
    transition, first, last = MODES.matrices(step_s)
    for axis, (omega, tau) in enumerate(zip(MODES.omega_rad_s, MODES.tau_s, strict=True)):
        square = omega**2
        system = np.array([[0, 1, 0, 0], [-square, -square * tau, square, 0], [0, 0, 0, 1 / step_s], [0, 0, 0, 0]])
        step = expm(step_s * system)
        scale = np.array([1.0, omega])  # velocities are compared with those of the mode
        np.testing.assert_allclose(transition[axis] / scale[:, None], step[:2, :2] / scale[:, None], atol=1e-8)
        np.testing.assert_allclose(first[axis] / scale, (step[:2, 2] - step[:2, 3]) / scale, atol=1e-8)
        np.testing.assert_allclose(last[axis] / scale, step[:2, 3] / scale, atol=1e-8)


def test_the_sensitivities_of_the_prediction_are_those_of_finite_differences(static_map: StaticMap) -> None:
    controller, task = HorizonControl(SETTINGS), _task(1.0, 3.0)
    times, samples_s = SETTINGS.reference_times(2.0), np.array([1.0, 2.0])
    feed, samples = task.feedforward_pa(times), TimedSetPoints(samples_s, task.feedforward_pa(samples_s))
    reference = ReferenceSamples(times, task.position_m(times), feed, 0.0)
    moving = np.stack([task.position_m(np.array([1.96]))[0], np.zeros(3)])
    state = HorizonState(moving, 1.96, TipEstimator(static_map).start(), times, feed)
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


def test_the_slopes_of_the_estimator_are_those_of_finite_differences(static_map: StaticMap) -> None:
    estimator = TipEstimator(static_map)
    rng = np.random.default_rng(0)
    start = estimator.start()
    state = start._replace(z=start.z + 1e-3 * rng.standard_normal(len(start.z)))
    case = (np.array([0.01, 0.0, 0.19]), np.array([0.1, -0.05, 0.0]), np.array([2e4, 3e4, 4e4]), 0.7, 1.0)
    _, slope = estimator.predict(state, *case)
    for k in range(len(state.z)):
        step = np.zeros(len(state.z))
        step[k] = 1e-6
        up = estimator.predict(state._replace(z=state.z + step), *case)[0]
        down = estimator.predict(state._replace(z=state.z - step), *case)[0]
        np.testing.assert_allclose(slope[:, k], (up - down) / 2e-6, atol=1e-7 * max(1.0, np.abs(slope[:, k]).max()))


def test_an_arm_unlike_the_model_follows_far_better_than_by_feedforward() -> None:
    task, truth = _task(1.0, 6.0), Truth(OTHER, np.array([1.03, 0.98, 1.0]))
    feedforward = simulate(SETTINGS, None, truth, task, seed=1)
    feedback = simulate(SETTINGS, HorizonControl(SETTINGS), truth, task, seed=1)
    assert feedforward.rms_m(3.0) > 1e-3
    assert feedback.rms_m(3.0) < 0.25e-3
    assert feedback.setpoint_pa.min() >= 0
    assert feedback.setpoint_pa.max() <= LIMIT_PA
    assert np.abs(np.diff(feedback.setpoint_pa, axis=0)).max() <= RATE_PA_S * 0.005 * (1 + 1e-9)
    # The innovations are not larger than the filter says: the NIS of three degrees of freedom has mean 3.
    nis = np.array([plan.estimate.nis for plan in feedback.plans[60:]])
    assert 0.5 < nis.mean() < 4.5


# The slow circle shows the payload least: there its camera noise costs 2 g, the soft arm of the test about 1 g.
# benchmarks.tip_payload gives the share of runs within 3 g.
@pytest.mark.parametrize(
    ("frequency_hz", "radius_m", "seed", "within_kg"),
    [(0.25, 0.02, 2, 0.0035), (0.4, 0.02, 3, 0.0015), (0.5, 0.025, 4, 0.0015), (0.3, 0.03, 5, 0.0015)],
)
def test_an_unknown_payload_is_weighed_and_compensated(
    frequency_hz: float, radius_m: float, seed: int, within_kg: float
) -> None:
    task = _task(frequency_hz, 8.0, radius_m)
    rng = np.random.default_rng(seed)
    truth = Truth(OTHER, 1 + 0.03 * rng.standard_normal(3), payload_kg=0.05, payload_at_s=5.0)
    run = simulate(SETTINGS, HorizonControl(SETTINGS), truth, task, seed)
    before = next(p for p in reversed(run.plans) if p.times_s[0] < 5.0).estimate
    after = next(p for p in run.plans if p.times_s[0] > 7.0).estimate
    assert after.payload_kg - before.payload_kg == pytest.approx(0.05, abs=within_kg)
    assert after.change_kg == pytest.approx(after.payload_kg - before.payload_kg, abs=5e-4)
    assert abs(after.change_kg - 0.05) < 2 * after.change_std_kg < 0.02
    off = np.linalg.norm(run.tip_m - run.reference_m, axis=1)
    assert off[run.times_s > 6.0].max() < 0.3e-3


def test_one_wrong_measurement_moves_no_estimate_and_more_as_of_a_payload_move_only_payload_and_offset(
    static_map: StaticMap,
) -> None:
    estimator = TipEstimator(static_map)
    started = estimator.start()
    settled = started._replace(covariance=1e-2 * started.covariance, frames=200)
    pressure = np.array([2e4, 3e4, 4e4])
    tip = static_map.tips(pressure[None])[0]
    prediction = estimator.predict(settled, tip, np.array([0.1, 0.0, 0.0]), pressure, 0.7, 1.0)
    wrong = (static_map.tips(pressure[None], 0.1)[0], 1e-8 * np.eye(3), prediction, 1 / 30, 1.0)
    once, _ = estimator.update(settled, *wrong)
    np.testing.assert_array_equal(once.z, settled.z)
    twice, _ = estimator.update(once, *wrong)
    moved = np.flatnonzero(twice.z != settled.z)
    assert moved.tolist() == [5, 6, 7, 8]  # payload and offset, after three strengths, softness and lag
    assert twice.settling > 0
    right = (tip, *wrong[1:])
    forgotten, _ = estimator.update(once, *right)
    assert forgotten.settling == 0


def test_a_sideways_shift_that_no_payload_explains_is_learned_within_half_a_second(static_map: StaticMap) -> None:
    estimator, rng = TipEstimator(static_map), np.random.default_rng(1)
    state, pressure, still = estimator.start(), np.array([4e4, 2e4, 2e4]), np.zeros(3)
    tip, shift = static_map.tips(pressure[None])[0], np.array([0.4e-3, 1.5e-3, -0.3e-3])
    for k in range(136):
        prediction = estimator.predict(state, tip, still, pressure, k / 30, None)
        measured = tip + (shift if k >= 120 else 0.0) + 5e-5 * rng.standard_normal(3)
        state, _ = estimator.update(state, measured, 2.5e-9 * np.eye(3), prediction, 1 / 30, None)
    predicted, _ = estimator.predict(state, tip, still, pressure, 136 / 30, None)
    np.testing.assert_allclose(predicted, tip + shift, atol=1.5e-4)
    estimate = estimator.estimate(state, 3.0)
    assert np.isnan(estimate.change_kg)
    assert abs(estimate.payload_kg) < 2 * estimate.payload_std_kg < 0.03


def test_a_disturbance_too_fast_to_be_learned_counts_as_noise(static_map: StaticMap) -> None:
    """Otherwise everything is learned again and again, each time from wider priors, and the estimates run away."""
    estimator, rng = TipEstimator(static_map), np.random.default_rng(1)
    state, still = estimator.start(), np.zeros(3)
    for k in range(600):
        pressure = 4e4 + 2e4 * np.sin(2.2 * k / 30 + np.array([0.0, 2.1, 4.2]))
        tip = static_map.tips(pressure[None])[0]
        fast = 5e-3 * np.sin(np.array([19.0, 23.0, 29.0]) * k / 30 + np.array([0.0, 1.0, 2.0]))
        prediction = estimator.predict(state, tip, still, pressure, k / 30, None)
        measured = tip + (fast if k >= 120 else 0.0) + 5e-5 * rng.standard_normal(3)
        state, nis = estimator.update(state, measured, 2.5e-9 * np.eye(3), prediction, 1 / 30, None)
        if k > 300:
            assert np.abs(state.z[:3] + state.z[estimator.layout.softness]).max() < 0.15
            assert np.linalg.norm(state.z[estimator.layout.offset]) < 4e-3
            assert nis < 20.0


def test_a_payload_that_sinks_in_slowly_is_weighed_from_the_frames_before_it_was_noticed(static_map: StaticMap) -> None:
    estimator, rng = TipEstimator(static_map), np.random.default_rng(1)
    state, pressure, still = estimator.start(), np.array([4e4, 2e4, 2e4]), np.zeros(3)
    tip, loaded = static_map.tips(pressure[None])[0], static_map.tips(pressure[None], 0.05)[0]
    noticed = []
    for k in range(180):
        prediction = estimator.predict(state, tip, still, pressure, k / 30, None)
        hung = np.clip((k - 120) / 8, 0, 1) * (loaded - tip)
        measured = tip + hung + 5e-5 * rng.standard_normal(3)
        state, _ = estimator.update(state, measured, 2.5e-9 * np.eye(3), prediction, 1 / 30, None)
        noticed.append(state.cloned is not None)
    assert not any(noticed[:122])
    assert noticed[127]
    estimate = estimator.estimate(state, 3.0)
    assert estimate.change_kg == pytest.approx(0.05, abs=1.5e-3)
    # The cap is not known as well as the change.
    assert 1e-3 < estimate.change_std_kg < estimate.payload_std_kg


@pytest.mark.parametrize("hung_kg", [0.25, 0.4])
def test_a_payload_beyond_the_range_of_the_map_is_compensated(hung_kg: float, static_map: StaticMap) -> None:
    """The map goes on along its tangent: a map that ends there tells the filter of effects that do not come."""
    estimator, rng = TipEstimator(static_map), np.random.default_rng(1)
    state, pressure, still = estimator.start(), np.array([4e4, 2e4, 2e4]), np.zeros(3)
    tip = static_map.tips(pressure[None])[0]
    by_payload = static_map.by_payload(pressure, 0.1)
    for k in range(300):
        prediction = estimator.predict(state, tip, still, pressure, k / 30, None)
        measured = tip + (hung_kg * by_payload if k >= 120 else 0.0) + 5e-5 * rng.standard_normal(3)
        state, _ = estimator.update(state, measured, 2.5e-9 * np.eye(3), prediction, 1 / 30, None)
        estimate = estimator.estimate(state, 3.0)
        assert abs(estimate.payload_kg) < 1.5 * hung_kg
    predicted, _ = estimator.predict(state, tip, still, pressure, 10.0, None)
    np.testing.assert_allclose(predicted, tip + hung_kg * by_payload, atol=2e-4)


def test_the_measurement_model_and_its_slope_by_the_payload_agree_beyond_the_range_of_the_map(
    static_map: StaticMap,
) -> None:
    estimator = TipEstimator(static_map)
    state = estimator.start()
    case = (np.array([0.01, 0.0, 0.19]), np.zeros(3), np.array([2e4, 3e4, 4e4]), 0.0, None)
    own = estimator.layout.payload
    beyond = state.z.copy()
    beyond[own] = 1.5 * LARGEST_PAYLOAD_KG
    predicted, slope = estimator.predict(state._replace(z=beyond), *case)
    beyond[own] += 0.01
    farther, _ = estimator.predict(state._replace(z=beyond), *case)
    np.testing.assert_allclose((farther - predicted) / 0.01, slope[:, own], rtol=1e-6)
    assert np.linalg.norm(slope[:, own]) > 1e-3


def test_the_same_run_is_the_same_bit_for_bit() -> None:
    task, truth = _task(1.0, 1.5), Truth(OTHER, np.ones(3))
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


def test_a_plan_never_leaves_the_limits() -> None:
    follower = PlanFollower(1, LIMIT_PA, RATE_PA_S)
    feed = np.array([3e4])
    follower.follow(0.0, 0.005, feed, np.zeros(1))
    assert follower.take(0.0, np.array([0.0, 0.01, 0.1, 0.2]), np.array([[3e4], [LIMIT_PA], [0.0], [LIMIT_PA]]))
    points = [follower.follow(0.005 * k, 0.005, feed, np.zeros(1)) for k in range(1, 40)]
    pressures = np.array([3e4, *(point.pressure_pa[0] for point in points)])
    assert pressures.min() >= 0
    assert pressures.max() <= LIMIT_PA
    assert np.abs(np.diff(pressures)).max() <= RATE_PA_S * 0.005 * (1 + 1e-12)
    assert max(abs(point.rate_pa_s[0]) for point in points) <= RATE_PA_S * (1 + 1e-12)


def test_an_old_plan_is_held() -> None:
    follower = PlanFollower(1, LIMIT_PA, RATE_PA_S)
    feed = np.array([3e4])
    follower.follow(0.0, 0.005, feed, np.zeros(1))
    follower.take(0.0, np.array([0.0, 1.0]), np.array([[3e4], [4e4]]))
    times = 0.005 * np.arange(1, 100)
    points = [follower.follow(float(t), 0.005, feed, np.zeros(1)) for t in times]
    assert follower.source is SetPointSource.HELD
    assert points[-1].pressure_pa[0] == pytest.approx(3e4 + 1e4 * LONGEST_S)
    assert points[-1].rate_pa_s[0] == 0.0


def test_without_new_plans_the_set_points_return_to_those_of_the_protocol_within_the_rate_limit() -> None:
    follower = PlanFollower(1, LIMIT_PA, RATE_PA_S)
    feed = np.array([3e4])
    follower.follow(0.0, 0.005, feed, np.zeros(1))
    follower.take(0.0, np.array([0.0, 1.0]), np.array([[3e4], [6e4]]))
    points = [follower.follow(0.005 * k, 0.005, feed, np.zeros(1)) for k in range(1, 300)]
    pressures = np.array([point.pressure_pa[0] for point in points])
    assert pressures.max() > 3.8e4
    assert np.abs(np.diff(pressures)).max() <= RATE_PA_S * 0.005 * (1 + 1e-12)
    assert pressures[-1] == 3e4
    assert follower.source is SetPointSource.LOST
    assert follower.take(1.5, np.array([1.5]), np.array([[3.1e4]]))
    follower.follow(1.505, 0.005, feed, np.zeros(1))
    assert follower.source is SetPointSource.PLAN


def test_a_controller_that_never_sends_a_plan_counts_as_lost() -> None:
    follower = PlanFollower(1, LIMIT_PA, RATE_PA_S)
    for k in range(250):
        assert follower.follow(0.005 * k, 0.005, np.array([3e4]), np.zeros(1)).pressure_pa[0] == 3e4
    assert follower.source is SetPointSource.LOST


@pytest.mark.parametrize(
    ("times", "values"),
    [
        ([5.0, 5.0], [[1.0], [1.0]]),
        ([5.0], [[np.nan]]),
        ([np.inf], [[1.0]]),
        ([], []),
        ([5.0], [[1.0, 2.0]]),
        ([5.0, 5.1], [[3e4], [-9.0]]),
        ([5.0, 5.1], [[3e4], [LIMIT_PA + 9.0]]),
        ([4.5, 5.5], [[3e4], [3e4]]),
        ([4.85, 5.5], [[3e4], [3e4]]),
        ([5.5, 5.6], [[3e4], [3e4]]),
    ],
    ids=[
        "times do not ascend", "not a number", "infinite time", "empty", "wrong shape", "negative", "above the limit",
        "old", "older than the plan before", "of the future",
    ],
)  # fmt: skip
def test_a_plan_that_cannot_be_followed_is_refused_and_the_one_before_is_kept(
    times: list[float], values: list[list[float]]
) -> None:
    follower = PlanFollower(1, LIMIT_PA, RATE_PA_S)
    assert follower.take(4.9, np.array([4.9, 5.9]), np.array([[3e4], [3e4]]))
    assert not follower.take(5.0, np.array(times), np.array(values, dtype=float))
    assert follower.follow(5.0, 0.005, np.array([2e4]), np.zeros(1)).pressure_pa[0] == 3e4


@pytest.mark.parametrize("name", sorted(CONTROLLERS))
def test_every_registered_controller_gives_a_plan(name: str) -> None:
    controller = controller_class(name)(SETTINGS)
    run = simulate(SETTINGS, controller, Truth(OTHER, np.ones(3)), _task(0.5, 0.5), seed=1)
    assert run.plans
    assert np.isfinite(run.setpoint_pa).all()


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("horizn", "one of feed-forward, horizon"),
        ("no_such_package_here:C", "in PYTHONPATH"),
        ("math:C", "has no C"),
        ("pathlib:Path", "start and step"),
    ],
)
def test_an_unknown_controller_is_refused_with_its_reason(name: str, reason: str) -> None:
    with pytest.raises(UnknownControllerError, match=reason):
        controller_class(name)


def test_the_examples_of_the_page_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = Path(__file__).parents[3] / "docs" / "explanation" / "tip-control.md"
    (text,) = re.findall(r"```python\n# own_controllers.py\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "own_controllers.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    task = _task(0.1, 4.0)
    truth = Truth(OTHER, np.array([1.03, 0.98, 1.0]))
    errors = [
        simulate(SETTINGS, controller_class(f"own_controllers:{name}")(SETTINGS), truth, task, seed=1).rms_m(2.0)
        for name in ("Inverse", "InverseAndIntegral")
    ]
    assert errors[1] < 0.7 * errors[0]
