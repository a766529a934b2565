"""The tip estimator makes up for loads, learns disturbances and is not misled by single measurements."""

from __future__ import annotations

import numpy as np
import pytest

from model.inverse.static_map import LARGEST_PAYLOAD_KG, StaticMap
from rig.tip_control.estimation.estimator import TipEstimator


def at_rest(tip_m: np.ndarray) -> np.ndarray:
    """The motion (3, 4) of a tip that does not move."""
    return np.column_stack([tip_m, np.zeros((3, 3))])


def test_the_slopes_of_the_estimator_are_those_of_finite_differences(static_map: StaticMap) -> None:
    estimator = TipEstimator(static_map)
    rng = np.random.default_rng(0)
    start = estimator.start()
    state = start._replace(z=start.z + 1e-3 * rng.standard_normal(len(start.z)))
    motion = np.array([[0.01, 0.1, -0.09, 1.0], [0.0, -0.05, 0.04, 2.0], [0.19, 0.0, 0.01, 0.0]])
    case = (motion, np.array([2e4, 3e4, 4e4]), 0.7, 1.0)
    _, slope = estimator.predict(state, *case)
    # The motion of the model contains the retardation already.
    np.testing.assert_array_equal(slope[:, estimator.layout.retardation], motion[:, 2])
    for k in set(range(len(state.z))) - {estimator.layout.retardation}:
        step = np.zeros(len(state.z))
        step[k] = 1e-6
        up = estimator.predict(state._replace(z=state.z + step), *case)[0]
        down = estimator.predict(state._replace(z=state.z - step), *case)[0]
        np.testing.assert_allclose(slope[:, k], (up - down) / 2e-6, atol=1e-7 * max(1.0, np.abs(slope[:, k]).max()))


def test_one_wrong_measurement_moves_no_estimate_and_more_as_of_a_payload_move_only_payload_and_offset(
    static_map: StaticMap,
) -> None:
    estimator = TipEstimator(static_map)
    started = estimator.start()
    settled = started._replace(covariance=1e-2 * started.covariance, frames=200)
    pressure = np.array([2e4, 3e4, 4e4])
    tip = static_map.tips(pressure[None])[0]
    motion = at_rest(tip)
    motion[0, 1], motion[0, 2] = 0.1, -0.1
    prediction = estimator.predict(settled, motion, pressure, 0.7, 1.0)
    wrong = (static_map.tips(pressure[None], 0.1)[0], 1e-8 * np.eye(3), prediction, 1 / 30, 1.0)
    once, _ = estimator.update(settled, *wrong)
    np.testing.assert_array_equal(once.z, settled.z)
    twice, _ = estimator.update(once, *wrong)
    moved = np.flatnonzero(twice.z != settled.z)
    assert moved.tolist() == [6, 7, 8, 9]  # payload and offset, after three strengths, softness, retardation and lag
    assert twice.settling > 0
    right = (tip, *wrong[1:])
    forgotten, _ = estimator.update(once, *right)
    assert forgotten.settling == 0


def test_a_sideways_shift_that_no_payload_explains_is_learned_within_half_a_second(static_map: StaticMap) -> None:
    estimator, rng = TipEstimator(static_map), np.random.default_rng(1)
    state, pressure = estimator.start(), np.array([4e4, 2e4, 2e4])
    tip, shift = static_map.tips(pressure[None])[0], np.array([0.4e-3, 1.5e-3, -0.3e-3])
    for k in range(136):
        prediction = estimator.predict(state, at_rest(tip), pressure, k / 30, None)
        measured = tip + (shift if k >= 120 else 0.0) + 5e-5 * rng.standard_normal(3)
        state, _ = estimator.update(state, measured, 2.5e-9 * np.eye(3), prediction, 1 / 30, None)
    predicted, _ = estimator.predict(state, at_rest(tip), pressure, 136 / 30, None)
    np.testing.assert_allclose(predicted, tip + shift, atol=1.5e-4)
    assert state.payload_before_kg is None
    assert abs(state.z[estimator.layout.payload]) < 0.03


def test_a_disturbance_too_fast_to_be_learned_counts_as_noise(static_map: StaticMap) -> None:
    """Otherwise everything is learned again and again, each time from wider priors, and the estimates run away."""
    estimator, rng = TipEstimator(static_map), np.random.default_rng(1)
    state = estimator.start()
    for k in range(600):
        pressure = 4e4 + 2e4 * np.sin(2.2 * k / 30 + np.array([0.0, 2.1, 4.2]))
        tip = static_map.tips(pressure[None])[0]
        fast = 5e-3 * np.sin(np.array([19.0, 23.0, 29.0]) * k / 30 + np.array([0.0, 1.0, 2.0]))
        prediction = estimator.predict(state, at_rest(tip), pressure, k / 30, None)
        measured = tip + (fast if k >= 120 else 0.0) + 5e-5 * rng.standard_normal(3)
        state, nis = estimator.update(state, measured, 2.5e-9 * np.eye(3), prediction, 1 / 30, None)
        if k > 300:
            assert np.abs(state.z[:3] + state.z[estimator.layout.softness]).max() < 0.15
            assert np.linalg.norm(state.z[estimator.layout.offset]) < 4e-3
            assert nis < 20.0


def test_a_payload_that_sinks_in_slowly_is_compensated(static_map: StaticMap) -> None:
    estimator, rng = TipEstimator(static_map), np.random.default_rng(1)
    state, pressure = estimator.start(), np.array([4e4, 2e4, 2e4])
    tip, loaded = static_map.tips(pressure[None])[0], static_map.tips(pressure[None], 0.05)[0]
    noticed = []
    for k in range(180):
        prediction = estimator.predict(state, at_rest(tip), pressure, k / 30, None)
        hung = np.clip((k - 120) / 8, 0, 1) * (loaded - tip)
        measured = tip + hung + 5e-5 * rng.standard_normal(3)
        state, _ = estimator.update(state, measured, 2.5e-9 * np.eye(3), prediction, 1 / 30, None)
        noticed.append(state.payload_before_kg is not None)
    assert not any(noticed[:122])
    assert noticed[127]
    predicted, _ = estimator.predict(state, at_rest(tip), pressure, 6.0, None)
    np.testing.assert_allclose(predicted, loaded, atol=5e-5)


@pytest.mark.parametrize("hung_kg", [0.25, 0.4])
def test_a_payload_beyond_the_range_of_the_map_is_compensated(hung_kg: float, static_map: StaticMap) -> None:
    """The map goes on along its tangent: a map that ends there tells the filter of effects that do not come."""
    estimator, rng = TipEstimator(static_map), np.random.default_rng(1)
    state, pressure = estimator.start(), np.array([4e4, 2e4, 2e4])
    tip = static_map.tips(pressure[None])[0]
    by_payload = static_map.by_payload(pressure, 0.1)
    for k in range(300):
        prediction = estimator.predict(state, at_rest(tip), pressure, k / 30, None)
        measured = tip + (hung_kg * by_payload if k >= 120 else 0.0) + 5e-5 * rng.standard_normal(3)
        state, _ = estimator.update(state, measured, 2.5e-9 * np.eye(3), prediction, 1 / 30, None)
        assert abs(state.z[estimator.layout.payload]) < 1.5 * hung_kg
    predicted, _ = estimator.predict(state, at_rest(tip), pressure, 10.0, None)
    np.testing.assert_allclose(predicted, tip + hung_kg * by_payload, atol=2e-4)


def test_the_measurement_model_and_its_slope_by_the_payload_agree_beyond_the_range_of_the_map(
    static_map: StaticMap,
) -> None:
    estimator = TipEstimator(static_map)
    state = estimator.start()
    case = (at_rest(np.array([0.01, 0.0, 0.19])), np.array([2e4, 3e4, 4e4]), 0.0, None)
    own = estimator.layout.payload
    beyond = state.z.copy()
    beyond[own] = 1.5 * LARGEST_PAYLOAD_KG
    predicted, slope = estimator.predict(state._replace(z=beyond), *case)
    beyond[own] += 0.01
    farther, _ = estimator.predict(state._replace(z=beyond), *case)
    np.testing.assert_allclose((farther - predicted) / 0.01, slope[:, own], rtol=1e-6)
    assert np.linalg.norm(slope[:, own]) > 1e-3
