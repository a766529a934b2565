"""`rig check` of a tip path: what can be followed, and why another cannot."""

from __future__ import annotations

import re
from functools import cache

import numpy as np
import pytest
import yaml
from scipy.interpolate import CubicSpline

import protocols
from model.dynamics import Dynamics
from protocols import BadInputError, Problem, SetPointTrajectory
from protocols.tip_inverse import TipRequest
from protocols.tip_paths import PiecewisePath
from rig.config.arm_model import model_arm
from rig.config.loader import load
from rig.experiment.preflight import check
from rig.tip_planning.assessment import assess
from rig.tip_planning.inverse import RESOLUTION, RigTipInverse, largest_share

pytestmark = pytest.mark.slow


@cache
def _inverse(rig: str = "mock-3") -> RigTipInverse:
    return RigTipInverse(load(rig))


def expanded(*tips: str, rig: str = "mock-3") -> SetPointTrajectory:
    steps = [{"hold": {"duration_s": 0.5}}, *({"tip": yaml.safe_load(tip)} for tip in tips)]
    return protocols.from_steps("t", steps).expand(3, _inverse(rig))


def refused(step: str, rig: str = "mock-3") -> Problem:
    with pytest.raises(BadInputError) as caught:
        expanded(step, rig=rig)
    (problem,) = caught.value.problems
    assert problem.where == "steps #2, tip"
    return problem


def circle(radius_mm: float, period_s: float, **more: str) -> str:
    words = ", ".join(f"{key}: {value}" for key, value in more.items())
    shape = f"circle: {{centre_mm: [0, 0, 190], radius_mm: {radius_mm}, period_s: {period_s}, periods: 4}}"
    return f"{{{shape}{', ' + words if words else ''}}}"


def test_the_model_under_the_set_points_follows_the_path_to_its_end() -> None:
    played = expanded(circle(20, 1))
    motion = played.tip.motions[0]
    times = np.arange(0, motion.stop_s, 0.002)
    dynamics = Dynamics(model_arm(load("mock-3")), 0.002)
    dynamics.start(np.zeros(3))
    tips = dynamics.run(played.sample(times)[1:]).tip_m
    inside = times[1:] >= motion.start_s
    reference = played.tip.sample(times[1:][inside])
    assert np.linalg.norm(tips[inside] - reference, axis=1).max() < 1e-4
    assert np.linalg.norm(played.tip.predicted_m(times[1:][inside]) - tips[inside], axis=1).max() < 1e-4
    assert check(load("mock-3"), played) == ()


def test_the_pressures_of_many_periods_are_those_of_a_few() -> None:
    short = expanded("{circle: {centre_mm: [0, 0, 190], radius_mm: 20, period_s: 1.3, periods: 5}}")
    long = expanded("{circle: {centre_mm: [0, 0, 190], radius_mm: 20, period_s: 1.3, periods: 40}}")
    for t_s in (3.5, 5.0, 7.123, 8.5):
        assert long.setpoint_pa(t_s) == pytest.approx(short.setpoint_pa(t_s), abs=20)
        assert long.setpoint_pa(t_s + 26 * 1.3) == pytest.approx(long.setpoint_pa(t_s + 10 * 1.3), abs=20)


def test_a_point_out_of_reach_is_refused_with_the_nearest_one() -> None:
    problem = refused("{hold: {at_mm: [0, 0, 240], duration_s: 2}}")
    assert "the arm does not reach it: actuator 1 at 0.7 bar" in problem.expected
    number = re.search(
        r"nearest reachable point is \(x .*?, y .*?, z ([\d.]+)\) mm, ([\d.]+) mm away", problem.expected
    )
    assert number is not None
    assert float(number[1]) + float(number[2]) == pytest.approx(240, abs=0.1)


def test_a_corner_that_is_missed_before_a_point_out_of_reach_does_not_hide_it() -> None:
    corners = "[[0, 0, 190], [20, 0, 240], [0, 0, 190]]"
    shape = f"points: {{at_mm: {corners}, speed_mm_per_s: 54, dwell_s: 0, ways: linear}}"
    problem = refused(f"{{{shape}, lead_in_s: 2}}")
    assert "(0.00 s into the path)" in problem.value
    number = re.search(
        r"but not \(x ([\d.]+), y 0.00, z ([\d.]+)\) mm at ([\d.]+) s: .*?, ([\d.]+) mm away", problem.expected
    )
    assert number is not None
    assert [float(one) for one in number.groups()] == pytest.approx([20, 240, 3.5, 20.8], abs=0.6)
    assert "of this speed" not in problem.expected


def test_a_path_that_is_too_fast_is_refused_with_speed_and_size_that_are_possible() -> None:
    problem = refused(circle(30, 0.8))
    assert "too fast for actuator" in problem.expected
    assert "at 1 bar/s" in problem.expected
    found = re.search(r"([\d.]+) of this speed \(period_s: ([\d.]+)\), or ([\d.]+) of this size", problem.expected)
    assert found is not None
    speed, size = float(found[1]), float(found[3])
    assert expanded(circle(30, 0.8 / speed)).tip
    assert expanded(circle(30 * size, 0.8)).tip
    with pytest.raises(BadInputError):
        expanded(circle(30, 0.8 / (speed + 0.05)))
    with pytest.raises(BadInputError):
        expanded(circle(30 * (size + 0.05), 0.8))


@pytest.mark.parametrize("period_s", [0.01, 0.005, 0.001])
def test_a_path_that_moves_between_the_times_of_the_solution_is_refused(period_s: float) -> None:
    problem = refused(circle(20, period_s))
    assert "mm off" in problem.value
    assert "neither 0.1 of its speed nor 0.1 of its size" in problem.expected


def test_a_path_shorter_than_a_time_step_is_assessed() -> None:
    config = load("mock-3")
    (found,) = assess(config, expanded("{hold: {at_mm: [0, 0, 190], duration_s: 0.001}}"), None)
    assert found.rate_margin_bar_s <= config.limits.rate_bar_per_s


def test_a_lead_in_that_is_too_short_is_named_as_the_reason() -> None:
    problem = refused(circle(20, 4, lead_in_s="0.2"))
    assert "in the lead-in" in problem.value
    number = re.search(r"a lead_in_s of ([\d.]+) is long enough", problem.expected)
    assert number is not None
    assert expanded(circle(20, 4, lead_in_s=number[1])).tip


def test_a_held_point_that_is_approached_too_fast_is_refused_with_a_lead_in_that_is_long_enough() -> None:
    problem = refused("{hold: {at_mm: [40, 0, 195], duration_s: 2}, lead_in_s: 0.05}")
    number = re.search(r"a lead_in_s of ([\d.]+) is long enough", problem.expected)
    assert number is not None
    assert expanded(f"{{hold: {{at_mm: [40, 0, 195], duration_s: 2}}, lead_in_s: {number[1]}}}").tip


@pytest.mark.parametrize("lead_in_s", [0, 0.05])
def test_a_path_without_a_lead_in_is_told_the_one_that_it_needs(lead_in_s: float) -> None:
    problem = refused(circle(20, 10, lead_in_s=str(lead_in_s)))
    number = re.search(r"a lead_in_s of ([\d.]+) is long enough", problem.expected)
    assert number is not None
    expanded(circle(20, 10, lead_in_s=number[1]))


def test_a_lead_in_that_helps_only_the_beginning_of_a_path_is_not_called_long_enough() -> None:
    way = (
        "[[-8.5, -26.4, 195.1], [38.6, 21.6, 196.3], [28.8, -21.4, 195.5], [36.2, 6.2, 193.6], [-18.5, 3.8, 210.5], "
        "[-39.5, 22.7, 205.9]]"
    )
    problem = refused(f"{{points: {{at_mm: {way}, move_s: 0.7}}, lead_in_s: 0}}")
    assert "largest possible with a lead_in_s of 3: 0.85 of this size" in problem.expected


def test_a_lead_in_is_named_where_no_speed_and_no_size_helps() -> None:
    shape = "centre_mm: [-18.7, -14.4, 204.5], normal: [-0.45, -0.43, 1.0], radius_mm: 8.44, period_s: 5.9, periods: 2"
    problem = refused(f"{{circle: {{{shape}}}, lead_in_s: 0.2}}")
    assert problem.expected.endswith("a lead_in_s of 3 is long enough")


def test_no_lead_in_helps_a_path_that_is_too_fast_itself() -> None:
    problem = refused("{points: {at_mm: [[20, 0, 190], [0, 40, 190]], speed_mm_per_s: 200}, lead_in_s: 0.3}")
    found = re.search(r"largest possible with a lead_in_s of 3: ([\d.]+) of this speed", problem.expected)
    assert found is not None
    speed = 200 * float(found[1])
    points = "points: {at_mm: [[20, 0, 190], [0, 40, 190]], speed_mm_per_s: "
    assert expanded(f"{{{points}{speed}}}, lead_in_s: 3}}").tip
    with pytest.raises(BadInputError):
        expanded(f"{{{points}{1.1 * speed}}}, lead_in_s: 3}}")


def test_coordinates_in_metres_are_recognised() -> None:
    problem = refused("{hold: {at_mm: [0.02, 0, 0.19], duration_s: 2}}")
    assert "are these metres? this step has mm" in problem.expected
    assert "-0.00" not in problem.expected


def test_a_rig_with_two_valves_controls_two_coordinates() -> None:
    problem = refused(circle(5, 4), "mock")
    assert problem.value == "the coordinates x, y, z"
    assert "at most 2, because rig mock has 2 valves" in problem.expected
    upright = "{circle: {centre_mm: [5, 0, 188], normal: [0, 1, 0], radius_mm: 5, period_s: 4, periods: 2}"
    played = expanded(f"{upright}, coordinates: [x, z]}}", rig="mock")
    assert check(load("mock"), played) == ()
    assert np.nanmax(np.abs(played.tip.motions[0].predicted_m - played.tip.motions[0].position_m)) < 5e-4


def test_consecutive_paths_join_without_a_stop() -> None:
    played = expanded(circle(20, 2), circle(15, 2, lead_in_s="1"))
    first, second = played.tip.motions
    assert second.velocity_m_s[0] == pytest.approx(first.velocity_m_s[-1], abs=2e-3)
    assert second.position_m[0] == pytest.approx(first.position_m[-1], abs=1e-4)
    assert check(load("mock-3"), played) == ()


@pytest.mark.parametrize("limit", [0.05, 0.11, 0.3, 0.568, 0.79, 0.81, 0.93, 0.99])
def test_the_largest_share_is_found_to_its_resolution_in_few_solutions(limit: float) -> None:
    tried = []

    def accepts(share: float) -> bool:
        tried.append(share)
        return share <= limit

    found = largest_share(accepts)
    if limit < 0.1:
        assert found == 0
    else:
        assert limit - RESOLUTION - 0.01 <= found <= limit
        assert found in tried
    assert len(tried) <= 7


@pytest.mark.parametrize(
    ("points", "speeds_mm_s"),
    [
        (
            [
                [-12.0, -20, 188],
                [-12, 20, 188],
                [8, 20, 190],
                [14, 12, 192],
                [8, 2, 194],
                [-12, 2, 192],
                [14, -20, 188],
            ],
            range(63, 112, 6),
        ),
        (
            [
                [9.166, -30.885, 188.868],
                [32.753, 26.287, 189.047],
                [25.096, -13.275, 203.604],
                [17.069, -5.868, 187.804],
                [-34.406, 26.51, 182.872],
            ],
            range(45, 75, 3),
        ),
    ],
)
def test_a_path_with_corners_that_is_accepted_is_accepted_at_slower_speeds(
    points: list[list[float]], speeds_mm_s: range
) -> None:
    accepted = []
    for speed in speeds_mm_s:
        times = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))] / speed
        path = PiecewisePath(times, 1e-3 * np.array(points), smooth=False)
        request = TipRequest(path, 3.0, (0, 1, 2), 5e-4, 0.0, np.zeros((101, 3)), 0.0)
        accepted.append(_inverse()._follower.accepts(request))
    assert accepted == sorted(accepted, reverse=True)
    assert accepted[0]
    assert not accepted[-1]


def test_a_corner_between_two_times_of_the_solution_counts() -> None:
    points = 1e-3 * np.array([[0.0, 0, 190], [10, 0, 190], [10, 10, 190]])
    path = PiecewisePath(np.array([0.0, 0.105, 0.21]), points, smooth=False)
    request = TipRequest(path, 2.0, (0, 1, 2), 5e-4, 0.0, np.zeros((101, 3)), 0.0)
    found = _inverse()._follower.follow(request, path)
    tips = CubicSpline(found.times_s, found.following.tip_m)
    fine = np.linspace(0.0, 0.21, 2101)
    off = np.linalg.norm(tips(fine) - path.positions_m(fine), axis=1)
    assert found.error_m.max() == pytest.approx(off.max(), rel=0.1)
