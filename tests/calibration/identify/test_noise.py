"""The adaptive noise: correlation, extra variance and outliers as in their textbooks; its bars hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import model
from calibration.identify import Setup, Verdict, identify
from calibration.identify.fitting.noise import correlation, extra_std
from calibration.identify.simulated_experiments import MeasurementErrors, exact, perform, plan

START = Setup(model.Arm.paper())
ERRORS = MeasurementErrors((2e-4, 2e-4, 2e-4), 10.0, 0.0)


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9])
def test_the_correlation_of_a_remembering_noise_is_its_autocorrelation_time(memory: float) -> None:
    noise = np.random.default_rng(1).standard_normal((6000, 3))
    found = correlation([lfilter([1.0], [1.0, -memory], noise, axis=0)])
    assert found == pytest.approx((1 + memory) / (1 - memory), rel=0.25)


def test_the_extra_variance_is_what_the_stated_one_lacks() -> None:
    rng = np.random.default_rng(2)
    stated = np.tile(np.diag([1e-8, 4e-8, 1e-8]), (2000, 1, 1))
    residual = rng.standard_normal((2000, 3)) * np.sqrt(np.diagonal(stated[0]) + 9e-8)
    assert extra_std(residual, stated, 0.0) == pytest.approx(3e-4, rel=0.05)
    as_stated = rng.standard_normal((2000, 3)) * np.sqrt(np.diagonal(stated[0]))
    assert extra_std(as_stated, stated, 0.0) == 0.0


def test_a_few_wrong_tips_hardly_change_the_extra_variance() -> None:
    residual = 1e-3 * np.random.default_rng(3).standard_normal((500, 3))
    spoiled = residual.copy()
    spoiled[:5] += 0.1
    nothing = np.tile(1e-12 * np.eye(3), (500, 1, 1))
    assert extra_std(spoiled, nothing, 0.0) == pytest.approx(extra_std(residual, nothing, 0.0), rel=0.1)


@pytest.mark.slow
def test_bars_hold_where_frames_remember_their_errors() -> None:
    """Errors of a slow motion that last for ten frames: the bars of independent ones would be three times too small."""
    phase = np.linspace(0, 6 * np.pi, 240)
    pressure = 0.35e5 + 0.25e5 * np.sin(np.stack([phase, phase + 2, phase + 4], axis=1))
    slow = replace(exact(plan("slow", pressure, errors=ERRORS), START), frames=np.ones(240, np.int64))
    inside, ratio = [], []
    for seed in range(24):
        noise = np.random.default_rng(seed).standard_normal((400, 3))
        error = 2e-4 * np.sqrt(1 - 0.8**2) * lfilter([1.0], [1.0, -0.8], noise, axis=0)[-240:]
        fit = identify([replace(slow, tip_m=slow.tip_m + error)], START, ("a1_per_n", "base"))
        a1 = fit["a1_per_n"]
        inside.append(abs(a1.used - START.arm.material.a1_per_n) < 1.96 * a1.posterior_std)
        ratio.append(fit.runs[0].correlation)
    assert np.mean(inside) >= 0.8
    assert 3 < np.median(ratio) < 15


def test_a_value_whose_interval_contains_no_effect_is_not_identified() -> None:
    material = replace(START.arm.material, rpe_per_bar=0.0)
    truth = Setup(START.arm.with_segment(material=material))
    pressure, rng = np.random.default_rng(3).uniform(0, 0.6e5, (30, 3)), np.random.default_rng(4)
    fine = MeasurementErrors((5e-5, 5e-5, 5e-5), 10.0, 0.0)
    data = [perform(plan("levels", pressure, errors=fine), truth, rng, fine)]
    found = identify(data, truth, ("a1_per_n", "rpe_per_bar"))["rpe_per_bar"]
    assert found.posterior_std < 0.008
    assert found.verdict is Verdict.ABSENT
    assert found.value is None
