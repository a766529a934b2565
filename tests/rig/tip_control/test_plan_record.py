"""Plans of a controller, which may be code of the user, are checked before they are followed."""

from __future__ import annotations

import numpy as np
import pytest

from rig.control.plan_follower import MOST_POINTS, StampedPlan


def test_lists_and_integers_are_a_plan() -> None:
    plan = StampedPlan.checked([0.0, 0.1], np.array([[1, 2], [3, 4]]), valves=2)
    assert plan.times_s.dtype == plan.setpoint_pa.dtype == np.float64
    assert plan.setpoint_pa.tolist() == [[1.0, 2.0], [3.0, 4.0]]


@pytest.mark.parametrize(
    "values", [np.array([[1 + 1j, 0]]), [["1", "2"]], [[True, False]], [[None, None]], [[object(), object()]]]
)
def test_set_points_that_are_no_real_numbers_are_refused_without_a_conversion(values: object) -> None:
    with pytest.raises(TypeError, match="setpoint_pa of a plan are real numbers; found an array of"):
        StampedPlan.checked([0.0], values, valves=2)


@pytest.mark.parametrize(
    ("times", "setpoints"),
    [([0.0], [[1.0]]), ([[0.0]], [[1.0, 2.0]]), (np.zeros(MOST_POINTS + 1), np.zeros((MOST_POINTS + 1, 2)))],
)
def test_plans_of_a_wrong_shape_are_refused(times: object, setpoints: object) -> None:
    with pytest.raises(ValueError, match="a set-point of each of 2 valves at each"):
        StampedPlan.checked(times, setpoints, valves=2)
