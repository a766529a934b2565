"""Iterative learning as pure steps: the smooth part of a difference, and repetitions on a simulated arm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import model
from benchmarks.support.tip_closed_loop import CYCLE_S, Task, Truth, simulate
from rig.tip_control.interface import TipControlSettings
from rig.tip_control.learning import STEP_S, DisturbanceLearner, PathPeriod, Repetition, smooth
from runs.interpolation import interpolated

pytestmark = pytest.mark.slow

LIMIT_PA, RATE_PA_S = 0.7e5, 1e5
DURATION_S = 4.0


def _arm() -> model.Arm:
    arm = model.Arm.paper()
    return arm.with_segment(material=replace(arm.material, damping_s=0.01))


ARM = _arm()
SETTINGS = TipControlSettings(ARM, (0, 1, 2), LIMIT_PA, RATE_PA_S, 1 / 30, 0.04, 0.015)
OTHER = ARM.with_segment(material=replace(ARM.material, a1_per_n=0.0077, rpe_per_bar=0.0515, density_kg_m3=1130.0))
TRUTH = Truth(OTHER, np.array([1.03, 0.98, 1.0]))
TIMES = np.arange(0.0, DURATION_S + 1.0, STEP_S)
TURNS = 2 * np.pi * np.where(TIMES < 1, 0.5 * TIMES**2, TIMES - 0.5)
CIRCLE = np.stack([0.02 * np.cos(TURNS), 0.02 * np.sin(TURNS), np.full_like(TURNS, 0.19)], axis=1)


@pytest.fixture(scope="module")
def learner() -> DisturbanceLearner:
    return DisturbanceLearner(SETTINGS)


EVEN_S = np.arange(300) / 30
UNEVEN_S = np.delete(EVEN_S + 0.01 * np.random.default_rng(3).uniform(-1, 1, 300), np.arange(10, 300, 7))


@pytest.mark.parametrize("frame_s", [EVEN_S, UNEVEN_S], ids=["even frames", "uneven frames, some dropped"])
def test_the_smooth_part_of_noise_is_almost_nothing_and_that_of_a_slow_motion_is_the_motion(
    frame_s: NDArray[np.float64],
) -> None:
    noise = 0.05 * np.random.default_rng(1).standard_normal((len(frame_s), 3))
    motion = np.sin(frame_s[:, None] + np.arange(3))
    assert np.std(smooth(frame_s, noise)(frame_s)) < 0.25 * np.std(noise)
    assert np.std(smooth(frame_s, motion + noise)(frame_s) - motion) < 0.3 * np.std(noise)


def test_the_smooth_part_of_too_few_values_is_zero() -> None:
    assert not smooth(EVEN_S[:4], np.ones((4, 3)))(EVEN_S[:4]).any()


def test_a_motion_that_repeats_itself_is_learned_better_if_its_period_is_known() -> None:
    period = PathPeriod(1.0, 0.0, 2.0)
    noise = 0.05 * np.random.default_rng(1).standard_normal((300, 3))
    motion = period.waves(EVEN_S)[:, [1, 3, 5]] + np.exp(-EVEN_S)[:, None]
    off, without = (np.std(smooth(EVEN_S, motion + noise, known)(EVEN_S) - motion) for known in (period, None))
    assert off < 0.35 * np.std(noise)
    assert without > 1.5 * off


def test_repetitions_make_the_error_of_a_feed_forward_small(learner: DisturbanceLearner) -> None:
    before = np.full((100, 3), 2e4)
    start = learner.tips(before, STEP_S)[-1]
    lead = np.clip(TIMES, 0, 1)[:, None]
    path = start + lead**3 * (10 + lead * (6 * lead - 15)) * (CIRCLE - start)
    feed = learner.setpoints(np.tile(before[-1], (len(TIMES), 1)), before, path, STEP_S)
    repetitions: list[Repetition] = []
    errors = []
    learned = np.zeros((len(TIMES), 3))
    for seed in range(3):
        run = simulate(SETTINGS, None, TRUTH, _task(path, feed), seed)
        errors.append(run.rms_m(1.0))
        given = interpolated(run.frame_s, TIMES, learned)
        repetitions = [Repetition(run.times_s, run.setpoint_pa, run.frame_s, run.measured_m, given)]
        learned = learner.disturbance(repetitions, TIMES)
        feed = learner.setpoints(feed, before, path - learned, STEP_S)
        assert feed.min() >= 0
        assert feed.max() <= LIMIT_PA
        assert np.abs(np.diff(feed, axis=0)).max() <= RATE_PA_S * STEP_S
    assert errors[0] > 1.5e-3
    assert errors[1] < 0.3 * errors[0]
    assert errors[2] < 0.1e-3


def test_a_free_coordinate_is_not_corrected(learner: DisturbanceLearner) -> None:
    before = np.full((100, 3), 2e4)
    feed = np.tile(before[-1], (200, 1))
    target = np.tile(learner.tips(before, STEP_S)[-1] + np.array([1e-3, 0.0, 5e-3]), (200, 1))
    target[:, 2] = np.nan
    tips = learner.tips(learner.setpoints(feed, before, target, STEP_S), STEP_S)
    np.testing.assert_allclose(tips[-1, :2], target[-1, :2], atol=2e-5)
    assert abs(tips[-1, 2] - tips[0, 2]) < 1e-3


def _task(path: np.ndarray, feed: np.ndarray) -> Task:
    def at(values: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        return lambda times_s: interpolated(times_s, TIMES, values)

    assert CYCLE_S == STEP_S
    return Task(DURATION_S, at(path), at(np.zeros_like(path)), at(feed), None)
