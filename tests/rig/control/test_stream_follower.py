"""Set-points of another program in the control loop: followed within the limits, or refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from protocols.trajectory import SetPointTrajectory, StreamInterval, TrajectorySegment
from rig.config.loader import load
from rig.control.interlocks.base import Sample
from rig.control.interlocks.conditions import SilentSource
from rig.control.limiter import Limiter
from rig.control.setpoints import Moment, RunSetPoints
from rig.control.stream_follower import StreamFollower
from runs.columns import StreamStatus
from runs.records import blank, streamed_dtype

CYCLE_S = 0.005
CONFIG = load("mock-3")
LIMIT_PA, RATE_PA_S = CONFIG.limits.pressure_bar * 1e5, CONFIG.limits.rate_bar_per_s * 1e5
LEVEL = (1e4, 2e4, 3e4)
INTERVAL = StreamInterval(1.0, 3.0, (1, 2, 3), 0.5, 1.0, 4)
SEGMENTS = (
    TrajectorySegment(0.0, 1.0, "hold", "", (), 3, LEVEL),
    TrajectorySegment(1.0, 3.0, "stream", "", (1, 2, 3), 4, LEVEL),
    TrajectorySegment(3.0, 6.0, "hold", "", (), 5, LEVEL),
)
TRAJECTORY = SetPointTrajectory(6.0, 3, SEGMENTS, (), "test", streams=(INTERVAL,))


def row(sequence: int, *pressure_pa: float, connection: int = 1) -> NDArray[np.void]:
    made = blank((), streamed_dtype(3))
    made["sequence"], made["connection"], made["setpoint_pa"] = sequence, connection, pressure_pa
    return made


class Loop:
    """A follower and the limiter at a protocol time that advances by control cycles."""

    def __init__(self) -> None:
        self.follower = StreamFollower(CONFIG, TRAJECTORY)
        self._setpoints, self._limiter = RunSetPoints(TRAJECTORY, (self.follower,)), Limiter.of(CONFIG)
        self.now_s = 0.0
        self.given = np.array(LEVEL)

    def until(self, to_s: float, *, stopped: bool = False) -> None:
        while self.now_s < to_s - 1e-9:
            self.now_s += CYCLE_S
            before = self.given
            now = Moment(self.now_s, CYCLE_S, stopped, self._limiter.last_pa)
            self.given, rate_pa_s = self._limiter.limit(self._setpoints.at(now), now, live=self._setpoints.live)
            assert (np.abs(rate_pa_s) <= RATE_PA_S).all()
            assert (np.abs(self.given - before) <= RATE_PA_S * CYCLE_S * (1 + 1e-9)).all()
            assert ((self.given >= 0) & (self.given <= LIMIT_PA)).all()

    def take(self, asked: NDArray[np.void], *, stopped: bool = False) -> StreamStatus:
        return StreamStatus(int(self.follower.take(asked, 0, self.now_s, stopped=stopped)["status"]))


def test_a_set_point_is_followed_within_the_rate_limit_and_left_at_it_after_the_step() -> None:
    loop = Loop()
    loop.until(1.0)
    np.testing.assert_array_equal(loop.given, LEVEL)
    assert loop.take(row(0, 2e4, 2e4, 5e4)) is StreamStatus.FOLLOWED
    loop.until(1.1)
    np.testing.assert_allclose(loop.given, [2e4, 2e4, 4e4])
    loop.until(1.4)
    np.testing.assert_allclose(loop.given, [2e4, 2e4, 5e4])
    loop.until(3.05)
    assert loop.given[2] == pytest.approx(4.5e4)
    loop.until(3.5)
    np.testing.assert_array_equal(loop.given, LEVEL)


@pytest.mark.parametrize("bad", [LIMIT_PA + 1, -1.0, np.nan, np.inf])
def test_a_set_point_out_of_limits_is_refused_and_the_set_points_stay(bad: float) -> None:
    loop = Loop()
    loop.until(1.0)
    assert loop.take(row(0, bad, 1e4, 1e4)) is StreamStatus.OUT_OF_LIMITS
    loop.until(1.2)
    np.testing.assert_array_equal(loop.given, LEVEL)


def test_sequence_numbers_must_grow_within_a_connection() -> None:
    loop = Loop()
    loop.until(1.0)
    assert loop.take(row(5, *LEVEL)) is StreamStatus.FOLLOWED
    assert loop.take(row(5, *LEVEL)) is StreamStatus.OUT_OF_ORDER
    assert loop.take(row(4, *LEVEL)) is StreamStatus.OUT_OF_ORDER
    assert loop.take(row(9, *LEVEL)) is StreamStatus.FOLLOWED
    assert loop.take(row(0, *LEVEL, connection=2)) is StreamStatus.FOLLOWED


def test_outside_of_the_step_and_in_a_pause_set_points_are_refused() -> None:
    loop = Loop()
    loop.until(0.5)
    assert loop.take(row(0, 0.0, 0.0, 0.0)) is StreamStatus.NOT_NOW
    loop.until(1.0)
    assert loop.take(row(1, 0.0, 0.0, 0.0), stopped=True) is StreamStatus.NOT_NOW
    loop.until(3.2)
    assert loop.take(row(2, 0.0, 0.0, 0.0)) is StreamStatus.NOT_NOW
    np.testing.assert_array_equal(loop.given, LEVEL)


def test_silence_trips_the_interlock_after_the_time_of_the_step_but_not_in_a_pause() -> None:
    def trip(loop: Loop, stalled_ns: int = 0) -> str:
        silence = loop.follower.silence
        assert silence is not None
        sample = Sample(0, 0, np.zeros(3), np.zeros(3), stalled_ns, silences=(silence,))
        found = SilentSource(CONFIG).trip(sample, new=True)
        return found.message if found else ""

    loop = Loop()
    loop.until(1.99)
    assert trip(loop) == ""
    loop.until(2.02)
    assert "no program has sent a set-point" in trip(loop)
    assert "connect_s of line 4" in trip(loop)
    loop = Loop()
    loop.until(1.5)
    loop.take(row(7, *LEVEL))
    loop.until(1.99)
    assert trip(loop) == ""
    loop.take(row(7, *LEVEL))  # refused: it does not count
    loop.until(2.02)
    assert "no set-point after number 7" in trip(loop)
    assert "timeout_s of line 4" in trip(loop)
    assert trip(loop, stalled_ns=100_000_000) == ""
    loop = Loop()
    loop.until(1.5)
    loop.take(row(7, *LEVEL))
    loop.until(2.5, stopped=True)
    assert trip(loop) == ""
    loop.until(3.1)
    assert loop.follower.silence is None


@pytest.mark.slow
@given(
    packets=st.lists(
        st.tuples(
            st.floats(0.0, 0.3),
            st.integers(0, 20),
            st.lists(st.floats(), min_size=3, max_size=3),
        ),
        max_size=12,
    )
)
def test_whatever_is_sent_the_set_points_keep_the_limits(packets: list[tuple[float, int, list[float]]]) -> None:
    loop = Loop()
    loop.until(0.9)
    for wait_s, sequence, values in packets:
        loop.take(row(sequence, *values))
        loop.until(loop.now_s + wait_s)
    loop.until(5.0)
