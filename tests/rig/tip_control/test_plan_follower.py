"""The plan follower keeps the limits, holds old plans and returns to the protocol without new ones."""

from __future__ import annotations

import numpy as np
import pytest

from rig.tip_control.plan_follower import LONGEST_S, PlanFollower, SetPointSource
from runs.records import SolveStatus
from tests.support.tip_control_task import LIMIT_PA, RATE_PA_S


def test_a_plan_never_leaves_the_limits() -> None:
    follower = PlanFollower(1, LIMIT_PA, RATE_PA_S)
    feed = np.array([3e4])
    follower.follow(0.0, 0.005, feed, np.zeros(1))
    plan = np.array([0.0, 0.01, 0.1, 0.2]), np.array([[3e4], [LIMIT_PA], [0.0], [LIMIT_PA]])
    assert follower.take(0.0, *plan) is None
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
    assert follower.take(1.5, np.array([1.5]), np.array([[3.1e4]])) is None
    follower.follow(1.505, 0.005, feed, np.zeros(1))
    assert follower.source is SetPointSource.PLAN


def test_a_controller_that_never_sends_a_plan_counts_as_lost() -> None:
    follower = PlanFollower(1, LIMIT_PA, RATE_PA_S)
    for k in range(250):
        assert follower.follow(0.005 * k, 0.005, np.array([3e4]), np.zeros(1)).pressure_pa[0] == 3e4
    assert follower.source is SetPointSource.LOST


@pytest.mark.parametrize(
    ("times", "values", "reason"),
    [
        ([5.0, 5.0], [[1.0], [1.0]], SolveStatus.MALFORMED),
        ([], [], SolveStatus.MALFORMED),
        ([5.0], [[1.0, 2.0]], SolveStatus.MALFORMED),
        ([5.0], [[np.nan]], SolveStatus.NOT_FINITE),
        ([np.inf], [[1.0]], SolveStatus.NOT_FINITE),
        ([5.0, 5.1], [[3e4], [-9.0]], SolveStatus.OUT_OF_LIMITS),
        ([5.0, 5.1], [[3e4], [LIMIT_PA + 9.0]], SolveStatus.OUT_OF_LIMITS),
        ([4.5, 5.5], [[3e4], [3e4]], SolveStatus.LATE),
        ([4.85, 5.5], [[3e4], [3e4]], SolveStatus.OUTDATED),
        ([5.5, 5.6], [[3e4], [3e4]], SolveStatus.EARLY),
    ],
    ids=[
        "times do not ascend", "empty", "wrong shape", "not a number", "infinite time", "negative", "above the limit",
        "old", "older than the plan before", "of the future",
    ],
)  # fmt: skip
def test_a_plan_that_cannot_be_followed_is_refused_with_its_reason_and_the_one_before_is_kept(
    times: list[float], values: list[list[float]], reason: SolveStatus
) -> None:
    follower = PlanFollower(1, LIMIT_PA, RATE_PA_S)
    assert follower.take(4.9, np.array([4.9, 5.9]), np.array([[3e4], [3e4]])) is None
    assert follower.take(5.0, np.array(times), np.array(values, dtype=float)) is reason
    assert follower.follow(5.0, 0.005, np.array([2e4]), np.zeros(1)).pressure_pa[0] == 3e4
