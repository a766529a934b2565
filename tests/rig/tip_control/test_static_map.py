"""The static map of tip control is the rod model, its slopes are exact and its inverse is the nearest point."""

from __future__ import annotations

import numpy as np

import model
from model.inverse.static_map import StaticMap
from model.statics import statics
from tests.support.tip_control_task import ARM, LIMIT_PA


def test_the_static_map_is_the_rod_model(static_map: StaticMap) -> None:
    pressures = np.random.default_rng(3).uniform(0, LIMIT_PA, (20, 3))
    hung = model.Loads(tip_force_n=0.03 * np.array(ARM.gravity_m_s2))
    rod = [statics(ARM, p, hung, doubt_units=False).tip_m for p in pressures]
    np.testing.assert_allclose(static_map.tips(pressures, 0.03), rod, atol=1e-5)


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


def test_points_without_a_target_keep_the_pressures_that_they_start_from(static_map: StaticMap) -> None:
    start = np.array([[1e4, 3e4, 2e4], [2e4, 2e4, 4e4]])
    target = np.array([static_map.tips(start[1:])[0], np.full(3, np.nan)])
    found = static_map.inverse(target, start)
    np.testing.assert_allclose(found[0], start[1], atol=10)
    np.testing.assert_array_equal(found[1], start[1])
