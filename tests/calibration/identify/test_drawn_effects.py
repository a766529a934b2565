"""Effects that are drawn for simulated arms have the prior that an identification assumes of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import model
from calibration.identify.drawn_effects import DrawnEffects, drawn_effects
from calibration.identify.model_error import TERMS, error_inputs
from calibration.identify.model_error_sampler import PRESENT
from calibration.identify.setup import Setup
from calibration.identify.simulated_experiments import MeasurementErrors, perform, plan
from model.material import MaxwellBranch

START = Setup(model.Arm.paper())
NO_ERRORS = MeasurementErrors((0.0, 0.0, 0.0), 0.0, 0.0)
RAMP = plan("ramp", np.linspace(0.15e5, 0.65e5, 5)[:, None] * [1.0, 0.6, 0.0], np.linspace(0.0, 0.1, 5))
PRIOR = error_inputs(RAMP, 0.65e5, TERMS).prior


def stronger(name: str, size: float) -> DrawnEffects:
    """One term alone, the common coefficient of all actuators, of this size."""
    term = next(k for k, one in enumerate(TERMS) if one.name == name)
    coefficients = np.zeros(len(PRIOR.term))
    coefficients[np.flatnonzero(PRIOR.term == term)[-1]] = size * (1 if TERMS[term].push is None else 2**0.5)
    return DrawnEffects(TERMS, coefficients, 0.65e5)


def test_drawn_coefficients_have_presence_mean_and_rms_of_the_prior() -> None:
    rng = np.random.default_rng(5)
    drawn = np.array([drawn_effects(START.arm, [RAMP], rng).coefficients for _ in range(4000)])
    scale = np.array([one.scale for one in TERMS])
    for k, term in enumerate(TERMS):
        own, mine = drawn[:, PRIOR.term == k], PRIOR.term == k
        present = own.any(axis=1)
        assert present.mean() == pytest.approx(PRESENT, abs=0.03), term.name
        rms = np.sqrt((own[present] ** 2).mean(axis=0))
        assert rms == pytest.approx(scale[k] * PRIOR.rms[mine], rel=0.15), term.name
        mean = own[present].mean(axis=0)
        assert mean == pytest.approx(scale[k] * (2 / np.pi) ** 0.5 * PRIOR.mean[mine], abs=0.15 * scale[k]), term.name


def test_what_the_model_contains_is_not_drawn() -> None:
    arm = START.arm.with_segment(material=replace(START.arm.material, branches=(MaxwellBranch(0.04, 2.0),)))
    drawn = drawn_effects(arm, [RAMP], np.random.default_rng(0))
    assert "time since step" not in {one.name for one in drawn.terms}
    assert len(drawn.terms) == len(TERMS) - 1


@pytest.mark.parametrize("moving", [False, True])
def test_an_arm_with_equally_stronger_actuators_does_what_higher_pressures_do(moving: bool) -> None:
    bar = 0.3 - 0.2 * np.cos(np.linspace(0.0, 4.0, 30))[:, None] * [1.0, 0.5, 0.0]
    planned = plan("run", 1e5 * bar, period_s=1 / 30 if moving else 0.0)
    harder = replace(planned, pressure_pa=1.04 * planned.pressure_pa)
    found = perform(planned, START, np.random.default_rng(0), NO_ERRORS, effects=stronger("gain", 0.04))
    expected = perform(harder, START, np.random.default_rng(0), NO_ERRORS)
    plain = perform(planned, START, np.random.default_rng(0), NO_ERRORS)
    assert found.tip_m == pytest.approx(expected.tip_m, abs=5e-6)
    assert np.abs(found.tip_m - plain.tip_m).max() > 2e-4
    assert found.pressure_pa == pytest.approx(plain.pressure_pa)


def test_an_arm_that_is_softer_under_loads_does_what_higher_weights_do() -> None:
    found = perform(RAMP, START, np.random.default_rng(0), NO_ERRORS, effects=stronger("load", 0.1))
    heavier = perform(replace(RAMP, weight_kg=1.1 * RAMP.weight_kg), START, np.random.default_rng(0), NO_ERRORS)
    assert found.tip_m == pytest.approx(heavier.tip_m, abs=1e-9)
    assert found.weight_kg == pytest.approx(RAMP.weight_kg)
