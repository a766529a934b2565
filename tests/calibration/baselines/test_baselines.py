"""Baselines: what they recover, how lag and regularisation are chosen, and the repeatability of an arm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calibration.baselines.comparison import MethodErrors, on_left_out
from calibration.baselines.repeatability import repeatability
from calibration.baselines.selection import fit_baselines
from calibration.identify.observations.poses import Poses
from calibration.identify.observations.pressure_course import PressureCourse
from calibration.identify.observations.pressure_lag import behind, lagged_pa
from calibration.identify.simulated_experiments import plan
from model.arrays import Array

GRAVITY = (0.0, 0.0, 9.81)
PERIOD_S = 0.05


def motion(pressure_bar: Array, tip_m: Array) -> Poses:
    """A motion with these pressures (K, 3) and tips (K, 3)."""
    still = plan("run", pressure_bar * 1e5, np.zeros(len(pressure_bar)))
    count = len(pressure_bar)
    return replace(still, period_s=PERIOD_S, tip_m=tip_m, time_s=np.arange(count) * PERIOD_S, course=None)


def steps(seed: int, count: int = 24, each: int = 25) -> Array:
    return np.repeat(np.random.default_rng(seed).uniform(0, 1, (count, 3)), each, axis=0)


def lagged(pressure_bar: Array, lag_s: float) -> Array:
    """By the difference equation, step by step."""
    out, keep = pressure_bar.copy(), np.exp(-PERIOD_S / lag_s)
    for k in range(1, len(out)):
        out[k] = keep * out[k - 1] + (1 - keep) * pressure_bar[k]
    return out


def bent(pressure_bar: Array) -> Array:
    """Tips (K, 3) of an arc of 0.2 m that one bar in a chamber bends by a radian, with a base 5 mm off."""
    angles = np.deg2rad([0, 120, 240])
    curve = pressure_bar @ np.stack([np.cos(angles), np.sin(angles)], axis=1)
    angle = np.linalg.norm(curve, axis=1) + 1e-12
    side = 0.2 * (1 - np.cos(angle)) / angle
    along = 0.2 * np.sin(angle) / angle
    return np.column_stack([curve * (side / angle)[:, None] + [0.005, 0], along])


def rms_mm(error: Array) -> float:
    return 1e3 * float(np.sqrt((error**2).sum(axis=1).mean()))


def test_a_lag_of_pressures_is_a_filter_of_first_order_from_the_first_pressure_on() -> None:
    pressure = steps(1)
    moving = motion(pressure, np.zeros_like(pressure))
    assert lagged_pa(moving, 0.5) == pytest.approx(1e5 * lagged(pressure, 0.5))
    assert behind(moving, 0.5) is moving

    at = np.arange(3, len(pressure), 7)
    course = PressureCourse(PERIOD_S, moving.pressure_pa, moving.weight_kg, moving.wrench, np.arange(len(pressure)))
    some = replace(moving, period_s=0.0, course=course).only(at)
    late = behind(some, 0.5)
    assert late.pressure_pa == pytest.approx(1e5 * lagged(pressure, 0.5)[at])
    assert late.course is not None
    assert late.course.pressure_pa[late.course.at] == pytest.approx(late.pressure_pa)


def test_each_baseline_predicts_the_arm_that_it_describes_with_the_lag_of_that_arm() -> None:
    seen, unseen = steps(2), steps(3)
    _, arc, _ = fit_baselines([motion(seen, bent(lagged(seen, 0.5)))], GRAVITY)
    other = motion(unseen, bent(lagged(unseen, 0.5)))
    assert arc.lag_s == 0.5
    assert rms_mm(arc.predict(other) - other.tip_m) < 0.3

    def quadratic(p: Array) -> Array:
        return np.column_stack([0.02 * p[:, 0] + 0.01 * p[:, 1] * p[:, 2], 0.03 * p[:, 1] ** 2, 0.1 - 0.01 * p[:, 2]])

    _, _, polynomial = fit_baselines([motion(seen, quadratic(lagged(seen, 2.0)))], GRAVITY)
    other = motion(unseen, quadratic(lagged(unseen, 2.0)))
    assert polynomial.lag_s == 2.0
    assert rms_mm(polynomial.predict(other) - other.tip_m) < 0.01


def test_an_arm_that_bends_as_an_arc_under_a_force_shows_its_compliance() -> None:
    rng = np.random.default_rng(4)
    pressure = rng.uniform(0, 0.5, (80, 3))
    force = rng.uniform(-0.2, 0.2, (80, 3)) * [1, 1, 0]
    tip = bent(pressure) + 0.05 * force
    run = replace(motion(pressure, tip), wrench=np.concatenate([force, np.zeros((80, 3))], axis=1))
    _, arc, _ = fit_baselines([run], GRAVITY)
    assert rms_mm(arc.predict(run) - tip) < 0.2 * rms_mm(0.05 * force)


def test_without_motion_the_error_is_that_of_the_median_tip() -> None:
    run = motion(steps(5), bent(steps(5)))
    still = fit_baselines([run], GRAVITY)[0]
    assert still.predict(run) == pytest.approx(np.broadcast_to(np.median(run.tip_m, axis=0), run.tip_m.shape))


def test_a_baseline_states_the_errors_of_blocks_that_it_did_not_see() -> None:
    rng = np.random.default_rng(6)
    seen, unseen = steps(7), steps(8)
    fits = fit_baselines([motion(seen, bent(seen) + rng.normal(0, 1e-3, seen.shape))], GRAVITY)
    other = motion(unseen, bent(unseen) + rng.normal(0, 1e-3, unseen.shape))
    errors = other.tip_m - fits[1].predict(other)
    table = on_left_out(fits, other, errors, np.broadcast_to(1e-6 * np.eye(3), (len(errors), 3, 3)), 0.2)
    by_name = {row.method: row for row in table.methods}
    assert 0.9 < by_name["constant curvature"].share_in_95 < 0.99
    assert by_name["constant curvature"].rms_m == pytest.approx(np.sqrt(3) * 1e-3, rel=0.1)
    assert by_name["rod"].rms_m == by_name["constant curvature"].rms_m
    assert "equally good" in table.sentence


def test_the_table_says_in_words_which_method_is_better() -> None:
    seen = steps(9)
    run = motion(seen, bent(seen))
    fits = fit_baselines([run], GRAVITY)
    stated = np.broadcast_to(1e-4 * np.eye(3), (len(seen), 3, 3))
    worse = on_left_out(fits, run, np.full_like(seen, 0.02), stated, 0.2)
    assert "constant curvature is better than the rod" in worse.sentence
    better = on_left_out(fits, run, np.full_like(seen, 1e-6), stated, 0.2)
    assert "the rod is better than the best baseline" in better.sentence


def test_errors_count_the_tips_that_have_a_prediction() -> None:
    error = np.array([[3e-3, 4e-3, 0], [np.nan] * 3, [0, 0, 0]])
    found = MethodErrors.of("rod", error, 1e-6 * np.eye(3))
    assert (found.rms_m, found.largest_m, found.share_in_95) == pytest.approx((5e-3 / np.sqrt(2), 5e-3, 0.5))


def test_the_repeatability_is_the_scatter_of_states_that_return_after_others() -> None:
    rng = np.random.default_rng(10)
    levels = np.tile([0.0, 1.0, 0.5], 40)
    offset = rng.normal(0, 1e-3, (120, 3))
    pressure = np.repeat(levels, 60)[:, None] * [1, 0, 0]
    tip = np.repeat(np.outer(levels, [0.05, 0, 0]) + offset, 60, axis=0)
    found = repeatability([motion(pressure, tip)])
    assert found is not None
    assert (found.states, found.repeats) == (3, 120)
    assert found.rms_m == pytest.approx(np.sqrt(3) * 1e-3, rel=0.1)


def test_states_that_never_return_tell_no_repeatability() -> None:
    pressure = np.repeat(np.linspace(0, 1, 12), 60)[:, None] * [1, 0, 0]
    assert repeatability([motion(pressure, pressure * 0.05)]) is None
