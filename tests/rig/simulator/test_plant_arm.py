"""The arm in the plant: it bends as its chambers fill, and its chambers grow as it bends."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from model.statics import statics
from rig.config.arm_model import model_arm, true_arm
from rig.config.loader import load
from rig.simulator.plant import Plant
from rig.simulator.tip_pose import pose_among, pose_dtype
from tests.support.plant_bench import mock_rig

BORE_M2 = math.pi * 9.5e-3**2
STILL = {"simulator__valve__leakage_l_min": 0.0, "simulator__valve__hysteresis_percent": 0.0}


@pytest.fixture(scope="module")
def bent() -> Plant:
    """Chamber 1 filled through the open valve for a moment, then closed and left to settle."""
    plant = Plant(mock_rig(**STILL), 1, 0)
    card = plant.card("daq")
    card.write(np.array([8.0, 0.0]))
    plant.advance(60_000_000)
    card.write(np.array([5.0, 0.0]))
    plant.advance(3_000_000_000)
    return plant


def test_at_rest_the_tip_is_where_the_true_arms_statics_put_it(bent: Plant) -> None:
    config = mock_rig(**STILL)
    assert bent.pressure_pa[0] > 0.2e5
    shape = statics(true_arm(config), bent.pressure_pa)
    pose = bent.pose_at(bent.t_ns)
    np.testing.assert_allclose(pose.position_m, shape.tip_m, atol=2e-5)
    np.testing.assert_allclose(pose.rotation, shape.tip_rotation, atol=1e-3)
    assert pose.position_m[0] < -5e-3


def test_the_chambers_have_the_volume_of_the_bent_arm(bent: Plant) -> None:
    shape = statics(true_arm(mock_rig(**STILL)), bent.pressure_pa)
    np.testing.assert_allclose(bent.volume_m3, 15e-6 + BORE_M2 * shape.actuator_lengths_m, rtol=1e-4)
    assert bent.volume_m3[0] > bent.volume_m3[1]


def test_the_simulated_arm_is_not_the_one_that_the_model_believes_in(bent: Plant) -> None:
    believed = statics(model_arm(mock_rig()), bent.pressure_pa).tip_m
    distance = np.linalg.norm(believed - bent.pose_at(bent.t_ns).position_m)
    assert 1e-4 < distance < 5e-3


def test_a_pose_between_two_steps_of_the_arm_lies_between_them() -> None:
    plant = Plant(mock_rig(), 1, 0)
    plant.card("daq").write(np.array([8.0, 0.0]))
    plant.advance(100_000_000)
    a, m, b = (plant.pose_at(t).position_m for t in (50_000_000, 52_500_000, 55_000_000))
    np.testing.assert_allclose(m, (a + b) / 2, atol=1e-12)
    assert np.linalg.norm(b - a) > 1e-5


def test_a_pose_of_more_than_a_second_ago_is_refused_and_one_within_is_known() -> None:
    plant = Plant(mock_rig(), 1, 0)
    plant.advance(3_000_000_000)
    plant.pose_at(2_000_000_000)
    with pytest.raises(LookupError, match="forgotten"):
        plant.pose_at(500_000_000)


def test_before_the_beginning_the_arm_hangs_at_rest() -> None:
    plant = Plant(mock_rig(), 1, 1_000_000_000)
    np.testing.assert_array_equal(plant.pose_at(0).position_m, plant.pose_at(1_000_000_000).position_m)


@given(st.integers(-10_000_000, 40_000_000), st.floats(-0.05, 0.05))
def test_an_interpolated_rotation_is_a_rotation(t_ns: int, angle: float) -> None:
    entries = np.zeros(3, pose_dtype())
    for i in range(3):
        c, s = math.cos(angle * i), math.sin(angle * i)
        entries[i] = (i, i * 5_000_000, (i, 0, 0), ((c, -s, 0), (s, c, 0), (0, 0, 1)))
    pose = pose_among(entries, t_ns)
    np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(pose.rotation) == pytest.approx(1.0)
    steps = min(max(t_ns / 5e6, 0.0), 6.0)
    assert pose.position_m[0] == pytest.approx(steps, abs=1e-9)
    turned = math.atan2(pose.rotation[1, 0], pose.rotation[0, 0])
    assert turned == pytest.approx(steps * angle, abs=2e-2 * abs(angle) * max(1.0, steps - 2))


@pytest.fixture(scope="module")
def segmented() -> Plant:
    """An arm of two segments, a chamber of the second one filled for a moment and left to settle."""
    config = load("mock-two-sections")
    assert config.simulator is not None
    still = config.simulator.valve.model_copy(update={"leakage_l_min": 0.0, "hysteresis_percent": 0.0})
    plant = Plant(config.model_copy(update={"simulator": config.simulator.model_copy(update={"valve": still})}), 1, 0)
    upper, lower = plant.card("upper"), plant.card("lower")
    upper.write(np.full(3, 5.0))
    lower.write(np.array([5.0, 8.0, 5.0]))
    plant.advance(50_000_000)
    lower.write(np.full(3, 5.0))
    plant.advance(3_000_000_000)
    return plant


def test_each_chamber_has_the_volume_along_its_own_segment(segmented: Plant) -> None:
    assert segmented.pressure_pa[4] > 0.2e5
    assert np.abs(np.delete(segmented.pressure_pa, 4)).max() < 0.05e5
    shape = statics(true_arm(load("mock-two-sections")), segmented.pressure_pa)
    bore_m2 = math.pi * np.repeat([9.5e-3, 7.5e-3], 3) ** 2
    np.testing.assert_allclose(segmented.volume_m3, 15e-6 + bore_m2 * shape.actuator_lengths_m, rtol=2e-4)
    np.testing.assert_allclose(segmented.pose_at(segmented.t_ns).position_m, shape.tip_m, atol=2e-5)


def test_a_plant_without_a_moving_arm_has_the_length_of_all_segments() -> None:
    plant = Plant(load("mock-two-sections"), 1, 0, moving_arm=False)
    assert plant.pose_at(0).position_m[2] == pytest.approx(0.215)
    bore_m2 = math.pi * np.repeat([9.5e-3, 7.5e-3], 3) ** 2
    np.testing.assert_allclose(plant.volume_m3, 15e-6 + bore_m2 * np.repeat([0.11, 0.09], 3))
