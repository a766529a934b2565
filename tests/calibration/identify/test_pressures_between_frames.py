"""A motion follows the pressures that were sampled between its frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import model
from calibration.identify import Setup
from calibration.identify.observations.pressure_samples import PressureSamples, on_even_frames
from calibration.identify.prediction.tip_predictor import Predictor
from calibration.identify.simulated_experiments import plan

CYCLE_S, FRAME_S = 1 / 240, 1 / 30
PER_FRAME = round(FRAME_S / CYCLE_S)


def damped_arm() -> Setup:
    arm = model.Arm.paper()
    return Setup(arm.with_segment(material=replace(arm.material, damping_s=0.01)))


def pulse(time_s: np.ndarray) -> np.ndarray:
    """A pulse of 25 ms that lies between two frames, [Pa]."""
    height = 0.1e5 * np.clip(1 - np.abs(time_s - 10.5 * FRAME_S) / (0.4 * FRAME_S), 0.0, None)
    return np.stack([0.2e5 + height, 0 * height, 0 * height], axis=1)


def test_a_pulse_between_two_frames_moves_the_predicted_tip() -> None:
    sampled_s = np.arange(20 * PER_FRAME + 1) * CYCLE_S
    samples = PressureSamples(sampled_s, pulse(sampled_s))
    frames = plan("frames", samples.pressure_pa[::PER_FRAME], period_s=FRAME_S)
    every_cycle = plan("cycles", samples.pressure_pa, period_s=CYCLE_S)
    expected = Predictor(every_cycle, 8)(damped_arm())[::PER_FRAME]
    found = Predictor(replace(frames, samples=samples), 4 * PER_FRAME)(damped_arm())
    unaware = Predictor(frames, 4 * PER_FRAME)(damped_arm())
    assert np.linalg.norm(unaware - expected, axis=1).max() > 1e-4
    assert np.linalg.norm(found - expected, axis=1).max() < 5e-6


def test_later_frames_of_a_motion_keep_the_pressures_of_their_time() -> None:
    sampled_s = np.arange(20 * PER_FRAME + 1) * CYCLE_S
    whole = plan("frames", pulse(sampled_s)[::PER_FRAME], period_s=FRAME_S)
    whole = replace(whole, samples=PressureSamples(sampled_s, pulse(sampled_s)))
    later = whole.only(np.arange(8, 21))
    assert later.samples is not None
    assert later.samples.at(later.frame_s + 0.5 * FRAME_S)[0] == pytest.approx(
        pulse((np.arange(8, 21) + 0.5) * FRAME_S), abs=1e-6
    )


def test_frames_at_uneven_times_keep_the_pressures_of_their_own_times() -> None:
    rng = np.random.default_rng(3)
    sampled_s = np.arange(0.0, 3.0, 0.005)
    pressure_pa = np.sin(2 * sampled_s)[:, None] * [0.2e5, 0.1e5, 0.0]
    frame_s = 1.0 + np.sort(np.arange(30) * FRAME_S + rng.uniform(-0.002, 0.002, 30))
    period_s = (frame_s[-1] - frame_s[0]) / 29
    found = on_even_frames(sampled_s, pressure_pa, frame_s, period_s)
    expected = np.sin(2 * frame_s)[:, None] * [0.2e5, 0.1e5, 0.0]
    # Even times would be wrong by up to 80 Pa.
    assert found.at(np.arange(30) * period_s)[0] == pytest.approx(expected, abs=8.0)
    assert found.time_s[0] < -0.9
    assert found.time_s[-1] > 29 * period_s + 0.9
