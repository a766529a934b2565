"""The plan follower keeps the limits, and goes on with the protocol and the last correction without new plans."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from rig.control.limiter import Limiter
from rig.control.plan_follower import LARGEST_CORRECTION, PlanFollower, SetPointSource
from rig.control.setpoints import Moment, SetPoint
from runs.records import SolveStatus
from tests.support.tip_control_task import LIMIT_PA, RATE_PA_S

CYCLE_S = 0.005


class Follower:
    """A follower of the plans of one valve with its limiter, in control cycles."""

    def __init__(self, no_plan_s: float = math.inf, on_path: Callable[[float], bool] = lambda protocol_s: True) -> None:
        self.plans = PlanFollower((0,), LIMIT_PA, no_plan_s, on_path)
        self.limiter = Limiter(0.0, LIMIT_PA, RATE_PA_S)
        self.take = self.plans.take

    @property
    def source(self) -> SetPointSource:
        """Where the last set-points came from."""
        return self.plans.source

    def follow(self, protocol_s: float, dt_s: float, feed_pa: np.ndarray, feed_rate_pa_s: np.ndarray) -> SetPoint:
        """The limited set-points of a cycle over those of a protocol."""
        now, below = Moment(protocol_s, dt_s, last_pa=self.limiter.last_pa), SetPoint(feed_pa, feed_rate_pa_s)
        live = self.plans.at(now, below)
        return self.limiter.limit(live or below, now, live=live is not None)


def test_a_plan_never_leaves_the_limits() -> None:
    follower = Follower()
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


def ramp_pa(t_s: float) -> np.ndarray:
    """The set-points of a protocol that goes on."""
    return np.array([3e4 + 5e3 * t_s])


def followed(follower: Follower, from_s: float, to_s: float) -> np.ndarray:
    """Pressures (n,) of the control cycles between two protocol times."""
    times = np.arange(round(from_s / CYCLE_S) + 1, round(to_s / CYCLE_S) + 1) * CYCLE_S
    points = [follower.follow(float(t), CYCLE_S, ramp_pa(t), np.array([5e3])) for t in times]
    return np.array([point.pressure_pa[0] for point in points])


def corrected(offset_pa: float) -> Follower:
    """A follower after two seconds of plans that are a constant correction of the protocol; the last begins at 2 s."""
    follower = Follower(no_plan_s=3.0)
    for k in range(61):
        start_s = k / 30
        times = start_s + np.array([0.0, 0.4])
        assert follower.take(start_s, times, np.array([ramp_pa(t) + offset_pa for t in times])) is None
        if k < 60:
            followed(follower, start_s, (k + 1) / 30)
    return follower


def test_the_correction_of_the_last_plan_goes_on_with_the_protocol_and_decays() -> None:
    follower = corrected(4e3)
    pressures = followed(follower, 2.0, 5.0)
    times = 2.0 + CYCLE_S * np.arange(1, len(pressures) + 1)
    correction = pressures - ramp_pa(times)[0]
    assert follower.source is SetPointSource.LOST
    np.testing.assert_allclose(correction[times < 2.3], 4e3, rtol=1e-6)
    assert np.abs(np.diff(correction)).max() < 0.02 * 4e3  # it neither jumps nor stands still
    assert (np.diff(correction) <= 1e-6).all()
    assert 0.3 * 4e3 < correction[times < 3.3][-1] < 0.7 * 4e3
    assert 0.0 < correction[-1] < 0.3 * 4e3


def test_a_large_correction_of_the_last_plan_is_reduced_to_its_limit_within_the_rate_limit() -> None:
    follower = corrected(2.5e4)
    pressures = followed(follower, 2.0, 2.6)
    times = 2.0 + CYCLE_S * np.arange(1, len(pressures) + 1)
    assert np.abs(np.diff(pressures)).max() <= RATE_PA_S * CYCLE_S * (1 + 1e-12)
    assert (pressures - ramp_pa(times)[0])[-1] <= LARGEST_CORRECTION * LIMIT_PA


def test_plans_that_come_again_are_reached_without_a_jump() -> None:
    follower = corrected(4e3)
    before = followed(follower, 2.0, 3.0)
    plan = 3.0 + np.array([0.0, 0.4]), np.array([[3.2e4], [3.2e4]])
    assert follower.take(3.0, *plan) is None
    after = followed(follower, 3.0, 3.29)
    assert follower.source is SetPointSource.PLAN
    assert abs(after[0] - before[-1]) < 0.2 * abs(before[-1] - 3.2e4)
    assert abs(after[-1] - 3.2e4) < 0.2 * abs(before[-1] - 3.2e4)


def test_where_a_plan_of_one_point_has_ended_its_correction_follows_the_protocol_until_the_next() -> None:
    follower = Follower()
    assert follower.take(0.0, np.array([0.0]), ramp_pa(0.0)[None] + 1e3) is None
    follower.follow(0.0, CYCLE_S, ramp_pa(0.0), np.array([5e3]))
    assert followed(follower, 0.0, 0.03)[-1] > ramp_pa(0.03)[0] + 100
    assert follower.source is SetPointSource.PLAN


def test_the_silence_counts_from_the_last_plan_or_the_begin_of_the_path_and_ends_with_the_path() -> None:
    follower = Follower(no_plan_s=3.0)
    assert follower.plans.silence is None
    followed(follower, 0.0, 0.2)
    assert follower.source is SetPointSource.PROTOCOL
    assert follower.take(0.2, np.array([0.2, 0.6]), np.array([[3e4], [3e4]])) is None
    followed(follower, 0.2, 1.2)
    silence = follower.plans.silence
    assert silence is not None
    assert silence.silent_s == pytest.approx(1.0)
    assert silence.limit_s == 3.0
    follower.plans.skip()
    assert follower.plans.silence is None


def test_a_controller_that_never_sends_a_plan_counts_as_lost_and_the_protocol_is_followed() -> None:
    follower = Follower()
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
    follower = Follower()
    assert follower.take(4.9, np.array([4.9, 5.9]), np.array([[3e4], [3e4]])) is None
    assert follower.take(5.0, np.array(times), np.array(values, dtype=float)) is reason
    assert follower.follow(5.0, 0.005, np.array([2e4]), np.zeros(1)).pressure_pa[0] == 3e4


def test_beyond_the_path_a_plan_is_refused_and_the_set_points_return_to_the_protocol_within_the_rate_limit() -> None:
    follower = Follower(on_path=lambda protocol_s: protocol_s < 1.0)
    assert follower.take(0.9, np.array([0.9, 1.3]), np.array([[3.4e4], [3.4e4]])) is None
    follower.follow(0.9, CYCLE_S, np.array([3.4e4]), np.zeros(1))
    points = [follower.follow(0.9 + CYCLE_S * k, CYCLE_S, np.array([3e4]), np.zeros(1)) for k in range(1, 60)]
    pressures = np.array([3.4e4, *(point.pressure_pa[0] for point in points)])
    assert follower.source is SetPointSource.PROTOCOL
    assert follower.take(1.1, np.array([1.1, 1.5]), np.array([[3.4e4], [3.4e4]])) is SolveStatus.NO_PATH
    assert np.abs(np.diff(pressures)).max() <= RATE_PA_S * CYCLE_S * (1 + 1e-12)
    assert pressures[-1] == 3e4
