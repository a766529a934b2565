"""The scan counter as a clock stays aligned with the clock of the computer over hours."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.hardware.cards.scan_clock import ScanClock
from tests.support.budget import examples

PERIOD_NS = 1_000_000.0
CYCLE_NS = 5_000_000


def play(clock: ScanClock, start_ns: int, true_period_ns: float, cycles: int, rng: np.random.Generator) -> list[float]:
    """Read every 5 ms with delays as of a busy machine; the error of the last stamp at each read [ns]."""
    errors, taken = [], 0
    for cycle in range(1, cycles + 1):
        now = start_ns + cycle * CYCLE_NS + round(rng.exponential(100_000))
        if rng.random() < 0.01:
            now += round(rng.uniform(0, 4e6))
        there = int((now - start_ns - 50_000) / true_period_ns)
        stamps = clock.stamp(there - taken, now)
        taken = there
        if len(stamps):
            errors.append(float(stamps[-1]) - (start_ns + taken * true_period_ns))
    return errors


@pytest.mark.slow
@examples(4)
@given(ppm=st.floats(-200, 200), seed=st.integers(0, 2**32 - 1))
def test_five_minutes_of_drift_stay_below_a_period(ppm: float, seed: int) -> None:
    clock = ScanClock(PERIOD_NS, 10**12)
    errors = play(clock, 10**12, PERIOD_NS * (1 + ppm * 1e-6), 60_000, np.random.default_rng(seed))
    assert np.abs(errors).max() < PERIOD_NS
    assert np.abs(errors[-20_000:]).max() < PERIOD_NS / 2
    assert clock.drift_ppm == pytest.approx(ppm, abs=20)


def test_without_drift_the_times_are_start_plus_index_times_period() -> None:
    clock = ScanClock(PERIOD_NS, 5_000)
    first, second = clock.stamp(3, 3_100_000), clock.stamp(2, 5_100_000)
    np.testing.assert_array_equal(
        np.concatenate([first, second]), [1_005_000, 2_005_000, 3_005_000, 4_005_000, 5_005_000]
    )


@examples(50)
@given(
    reads=st.lists(st.tuples(st.integers(0, 50), st.integers(0, 10**10)), min_size=1, max_size=40),
    period_ns=st.floats(1e4, 1e8),
)
def test_times_increase_whatever_the_delays_are(reads: list[tuple[int, int]], period_ns: float) -> None:
    clock, now, times = ScanClock(period_ns, 0), 0, []
    for scans, wait_ns in reads:
        now += wait_ns
        times.append(clock.stamp(scans, now))
    assert np.all(np.diff(np.concatenate(times)) > 0)


@given(away=st.integers(0, 10_000))
def test_a_restart_reports_the_lost_scans_and_continues_from_there(away: int) -> None:
    clock = ScanClock(PERIOD_NS, 0)
    (before,) = clock.stamp(1, 1_000_000)
    start_ns = int(before) + round((away + 0.5) * PERIOD_NS)
    assert clock.restart(start_ns) == away
    (after,) = clock.stamp(1, start_ns + 1_100_000)
    assert after == start_ns + 1_000_000


def test_a_restart_keeps_the_estimated_drift() -> None:
    clock = ScanClock(PERIOD_NS, 0)
    play(clock, 0, PERIOD_NS * 1.0001, 60_000, np.random.default_rng(1))
    learnt = clock.drift_ppm
    assert learnt == pytest.approx(100, abs=20)
    clock.restart(10**12)
    assert clock.drift_ppm == learnt
