"""The sender's clock: offset and drift from one-way delays, with an interval that holds the true time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from model.arrays import Array
from rig.hardware.trackers.sender_clock import SenderClock

MINIMUM_S = 3e-3


def estimates(
    jitter_s: float, seed: int, drift: float = 100e-6, seconds: float = 15.0, rate_hz: float = 100.0
) -> tuple[SenderClock, Array, Array]:
    """Errors of the estimated times (k,) and their stated standard uncertainties, every second."""
    random = np.random.default_rng(seed)
    clock, errors, stds = SenderClock(), [], []
    for k in range(round(seconds * rate_hz)):
        t_s = k / rate_hz
        sent_ns = round(t_s * (1 + drift) * 1e9) + 10**18
        used = clock.add(sent_ns, round((t_s + MINIMUM_S + random.exponential(jitter_s)) * 1e9))
        if used and clock.ready and k % round(rate_hz) == 0:
            errors.append(clock.ours_ns(sent_ns) * 1e-9 - t_s - MINIMUM_S)
            stds.append(clock.estimate(sent_ns).std_s)
    return clock, np.array(errors), np.array(stds)


@pytest.mark.parametrize("jitter_s", [1e-3, 10e-3])
def test_a_clock_that_drifts_is_known_far_better_than_the_jitter(jitter_s: float) -> None:
    clock, errors, stds = estimates(jitter_s, seed=3)
    assert abs(errors[-1]) < 0.02 * jitter_s
    assert np.mean(np.abs(errors) <= 1.96 * stds) > 0.8
    assert clock.estimate(10**18 + 15 * 10**9).drift == pytest.approx(-100e-6, abs=20e-6)
    assert clock.steps == 0


def test_the_constant_part_of_the_delay_stays_in_the_offset() -> None:
    clock = SenderClock()
    for k in range(200):
        clock.add(k * 10_000_000, k * 10_000_000 + 7_000_000 + (k % 7) * 100_000)
    assert clock.estimate(0).offset_s == pytest.approx(7e-3, abs=1e-6)


@pytest.mark.parametrize("step_s", [-0.5, -0.02, 0.02, 0.5])
def test_a_step_of_the_senders_clock_is_told_from_delay(step_s: float) -> None:
    random, clock = np.random.default_rng(1), SenderClock()
    for k in range(500):
        t_s = k * 0.01
        sent_ns = round((t_s + (step_s if k >= 250 else 0.0)) * 1e9)
        clock.add(sent_ns, round((t_s + MINIMUM_S + random.exponential(1e-3)) * 1e9))
    assert clock.steps == 1
    assert clock.ours_ns(sent_ns) * 1e-9 - MINIMUM_S == pytest.approx(t_s, abs=2e-4)


def test_a_small_step_is_followed_although_jitter_brings_messages_back_to_the_old_line() -> None:
    for seed in range(12):
        random, clock = np.random.default_rng(seed), SenderClock()
        for k in range(1500):
            t_s = k * 0.01
            sent_ns = round((t_s + (0.02 if k >= 1000 else 0.0)) * 1e9)
            clock.add(sent_ns, round((t_s + MINIMUM_S + random.gamma(2, 5e-3)) * 1e9))
        assert clock.ours_ns(sent_ns) * 1e-9 - MINIMUM_S == pytest.approx(t_s, abs=4e-3)


def drifting(
    offset_s: Callable[[float], float], seconds: float, largest: float = 200e-6
) -> tuple[list[SenderClock], Array, Array]:
    """Errors of the estimated times after 2 s and their stated uncertainties in some trials.

    The sender's clock is ahead by a function of the time.
    """
    errors, stds, clocks = [], [], []
    for seed in range(3):
        random, clock = np.random.default_rng(seed), SenderClock(largest)
        for k in range(round(seconds * 100)):
            t_s = k * 0.01
            sent_ns = round((t_s + offset_s(t_s)) * 1e9) + 10**18
            used = clock.add(sent_ns, round((t_s + MINIMUM_S + random.exponential(1e-3)) * 1e9))
            if used and clock.ready and t_s > 2:
                errors.append(clock.ours_ns(sent_ns) * 1e-9 - t_s - MINIMUM_S)
                stds.append(clock.estimate(sent_ns).std_s)
        clocks.append(clock)
    return clocks, np.array(errors), np.array(stds)


@pytest.mark.parametrize("drift", [0.0, 100e-6, -100e-6, 500e-6, -500e-6])
def test_the_uncertainty_holds_for_any_drift_below_the_stated_one(drift: float) -> None:
    clocks, errors, stds = drifting(lambda t_s: drift * t_s, 20.0, largest=1000e-6)
    assert np.mean(np.abs(errors) <= 1.96 * stds) > 0.9
    assert np.abs(errors).max() < 0.1e-3
    for clock in clocks:
        assert clock.estimate(10**18 + 20 * 10**9).drift == pytest.approx(-drift, abs=5e-6)
        assert clock.steps == 0


@pytest.mark.parametrize("drift", [500e-6, -500e-6])
def test_a_drift_above_the_stated_one_widens_the_uncertainty_and_is_no_step(drift: float) -> None:
    clocks, errors, stds = drifting(lambda t_s: drift * t_s, 20.0)
    assert np.mean(np.abs(errors) <= 1.96 * stds) > 0.9
    assert np.abs(errors).max() < 2e-3
    for clock in clocks:
        assert abs(clock.estimate(10**18).drift) == 200e-6
        assert clock.steps == 0


@pytest.mark.slow
@pytest.mark.parametrize("slew", [100e-6, -100e-6, 20e-6, -20e-6])
def test_a_drift_that_changes_is_followed_and_the_uncertainty_holds(slew: float) -> None:
    """NTP changes the rate of a clock for a while."""
    clocks, errors, stds = drifting(lambda t_s: slew * float(np.clip(t_s - 15, 0, 10)), 40.0)
    assert np.mean(np.abs(errors) <= 1.96 * stds) > 0.75
    assert np.abs(errors).max() < 0.4e-3
    assert [clock.steps for clock in clocks] == [0] * len(clocks)


def test_one_late_message_changes_nothing() -> None:
    clock = SenderClock()
    for k in range(200):
        clock.add(k * 10_000_000, k * 10_000_000 + 3_000_000 + (k % 5) * 10_000)
    before = clock.estimate(2 * 10**9)
    clock.add(200 * 10_000_000, 200 * 10_000_000 + 80_000_000)
    assert clock.estimate(2 * 10**9) == before


def test_a_forged_time_far_ahead_is_not_believed_at_once() -> None:
    clock = SenderClock()
    for k in range(200):
        clock.add(k * 10_000_000, k * 10_000_000 + 3_000_000 + (k % 5) * 10_000)
    before = clock.estimate(2 * 10**9)
    assert not clock.add(10**12, 200 * 10_000_000)
    assert clock.estimate(2 * 10**9) == before
    assert clock.steps == 0
