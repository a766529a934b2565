"""Errors that neighbours share: they are found in the residuals, and the error bars count them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import model
from calibration.identify import Poses, Prior, Setup, identify
from calibration.identify.likelihood import apply_frequency_mask, drifting, frequency_mask, score_covariance
from calibration.identify.results import NORMAL_95
from calibration.identify.simulated_experiments import MeasurementErrors, plan
from calibration.identify.tip_predictor import Predictor

FRAMES, CAMERA_HZ = 240, 30
TIP_M = 2e-4
START = Setup(model.Arm.paper())


def slow_motion() -> Poses:
    """Two sines, each frame of which is an equilibrium."""
    phase = np.linspace(0, 4 * np.pi, FRAMES)[:, None] * np.array([1.0, 1.5, 1.5])
    planned = plan(
        "slow", 1e5 * (0.35 + 0.25 * np.sin(phase)), errors=MeasurementErrors((TIP_M, TIP_M, TIP_M), 0.0, 0.0)
    )
    return replace(planned, frames=np.ones(FRAMES, np.int64))


def shared_errors(rng: np.random.Generator, memory: float) -> np.ndarray:
    """Errors (FRAMES, 3) of unit variance, each remembering the one before."""
    out = np.empty((FRAMES, 3))
    out[0] = rng.standard_normal(3)
    for k in range(1, FRAMES):
        out[k] = memory * out[k - 1] + np.sqrt(1 - memory**2) * rng.standard_normal(3)
    return out


@pytest.mark.slow
def test_correlated_frames_of_a_slow_motion_count_as_fewer_entries() -> None:
    planned = slow_motion()
    true = Predictor(planned)(START)
    rng = np.random.default_rng(8)
    z: dict[bool, list[float]] = {True: [], False: []}
    for _ in range(16):
        tips = true + TIP_M * shared_errors(rng, 0.9)
        for known in z:
            # Plateaus, of several frames each, are taken to err by themselves.
            data = replace(planned, tip_m=tips, frames=planned.frames if known else planned.frames * 9)
            found = identify([data], START, ["rpe_per_bar", "base_z_m"])
            for name, truth in (("rpe_per_bar", START.arm.material.rpe_per_bar), ("base_z_m", 0.0)):
                assert found[name].std is not None
                z[known].append((found[name].used - truth) / found[name].std)
    assert np.std(z[True]) < 1.5
    assert np.std(z[False]) > 2


@pytest.mark.slow
@pytest.mark.parametrize("memory", [0.0, 0.5, 0.8, 0.9])
def test_error_bars_cover_the_truth_for_any_correlation_length(memory: float) -> None:
    phase = np.linspace(0, 4 * np.pi, FRAMES)
    slope = np.zeros((FRAMES, 3, 3))
    slope[:, 0, 0], slope[:, 1, 0], slope[:, 2, 1], slope[:, 0, 2] = np.sin(phase), np.sin(1.5 * phase), 1.0, 1.0
    rows = slope.reshape(-1, 3)
    covariance, gain = np.linalg.inv(rows.T @ rows), np.ones(FRAMES // 2 + 1)
    rng, z = np.random.default_rng(6), []
    for _ in range(150):
        errors = shared_errors(rng, memory)
        found = covariance @ rows.T @ errors.ravel()
        left = errors - (rows @ found).reshape(FRAMES, 3)
        bars = covariance @ score_covariance(left, slope, gain, 1.0, covariance) @ covariance
        z.append(found / np.sqrt(np.diagonal(bars)))
    # 150 trials of two parameters that hardly know of each other and one that does.
    assert 0.9 < (np.abs(z) < NORMAL_95).mean() < 0.99
    assert 0.75 < np.std(z) < 1.2


def test_residuals_that_correlate_over_a_tenth_of_the_run_are_reported_as_drift() -> None:
    rng = np.random.default_rng(7)
    said = {memory: np.mean([drifting(shared_errors(rng, memory)) for _ in range(30)]) for memory in (0.0, 0.8, 0.99)}
    assert said[0.0] == 0.0
    assert said[0.8] < 0.1
    assert said[0.99] > 0.7
    planned = slow_motion()
    tips = Predictor(planned)(START) + TIP_M * shared_errors(rng, 0.99)
    fit = identify([replace(planned, tip_m=tips)], START, ["rpe_per_bar"])
    assert "drifts" in fit.drifts
    assert not identify([replace(planned, tip_m=tips, frames=planned.frames * 9)], START, ["rpe_per_bar"]).drifts


def test_score_covariance_of_independent_errors_equals_the_information() -> None:
    rng = np.random.default_rng(2)
    slope = np.sin(np.linspace(0, 12, FRAMES))[:, None, None] * np.ones((1, 3, 1))
    curvature = np.einsum("kin,kim->nm", slope, slope)
    gain = np.ones(FRAMES // 2 + 1)
    found = [
        score_covariance(rng.standard_normal((FRAMES, 3)), slope, gain, 1.0, np.linalg.inv(curvature))[0, 0]
        for _ in range(40)
    ]
    # Found from few numbers, it is made a sixth larger, by which the bars hold all the same.
    assert np.mean(found) == pytest.approx(curvature[0, 0], rel=0.2)


def test_low_frequency_noise_is_found_at_its_frequencies() -> None:
    rng = np.random.default_rng(3)
    slow, fast = np.linspace(0, 12, FRAMES), np.arange(FRAMES) * np.pi * 0.9
    gain = np.ones(FRAMES // 2 + 1)
    ratio = {}
    for name, phase in (("slow", slow), ("fast", fast)):
        slope = np.sin(phase)[:, None, None] * np.ones((1, 3, 1))
        curvature = np.einsum("kin,kim->nm", slope, slope)
        pulls = [
            score_covariance(shared_errors(rng, 0.9), slope, gain, 1.0, np.linalg.inv(curvature))[0, 0]
            for _ in range(20)
        ]
        ratio[name] = np.mean(pulls) / curvature[0, 0]
    assert ratio["slow"] > 4
    assert ratio["fast"] < 1


def test_frequencies_without_pressure_signal_are_masked() -> None:
    time_s = np.arange(FRAMES) / CAMERA_HZ
    noise = 50 * np.random.default_rng(4).standard_normal((FRAMES, 3))
    errors = MeasurementErrors(pressure_pa=50.0)

    def gain(pressure_pa: np.ndarray) -> np.ndarray:
        return frequency_mask(plan("motion", pressure_pa + noise, period_s=1 / CAMERA_HZ, errors=errors))

    hz = np.fft.rfftfreq(FRAMES, 1 / CAMERA_HZ)
    sine = gain(2e4 * np.sin(2 * np.pi * time_s)[:, None] * np.ones(3))
    assert (sine[hz <= 1.0] == 1).all()
    assert (sine[hz > 4.0] == 0).all()
    # A jump shows at every frequency.
    assert (gain(3e4 * (np.floor(time_s) % 2)[:, None] * np.ones(3))[hz < 10] == 1).all()
    rows = np.stack([np.sin(2 * np.pi * time_s), np.sin(2 * np.pi * 8 * time_s)], axis=1)
    left = apply_frequency_mask(rows, sine)
    assert left[:, 0] == pytest.approx(rows[:, 0], abs=1e-9)
    assert np.abs(left[:, 1]).max() < 1e-9


@pytest.mark.slow
def test_correlated_frames_do_not_outweigh_a_prior_by_their_number() -> None:
    planned = slow_motion()
    true = Predictor(planned)(START)
    rng, prior = np.random.default_rng(12), Prior(START.arm.geometry.length_m, 5e-4)
    errors_m, bars_m = [], []
    for _ in range(8):
        data = replace(planned, tip_m=true + 1e-3 * shared_errors(rng, 0.9))
        found = identify([data], START, ["rpe_per_bar", "length_m"], {"length_m": prior})["length_m"]
        assert found.std is not None
        errors_m.append(found.used - prior.mean)
        bars_m.append(found.std)
    rms_m = np.sqrt(np.mean(np.square(errors_m)))
    assert rms_m < 1.1 * np.mean(bars_m)
    # Weighted by the number of frames they err by 0.75 of the prior's deviation.
    assert rms_m < 0.6 * prior.std
