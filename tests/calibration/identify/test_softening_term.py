"""Softening by the pressures so far, as an error of the model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import model
from calibration.identify.fit import identify
from calibration.identify.model_error import TERMS
from calibration.identify.nuisance import stated_values
from calibration.identify.poses import Poses
from calibration.identify.pressure_history import pressure_history
from calibration.identify.setup import Setup
from calibration.identify.simulated_experiments import MeasurementErrors, perform, plan
from model.arrays import Array
from rig.arm_effects.effects import SofteningSection

PA = 1e5
START = Setup(model.Arm.paper())
ERRORS = MeasurementErrors((3e-5, 3e-5, 6e-5), 20.0, 0.0)
UP_AND_DOWN = np.concatenate([np.linspace(0.1, 0.6, 6), np.linspace(0.5, 0.1, 5), np.linspace(0.2, 0.6, 5)])


def softened(name: str, levels_bar: Array, by_peak: float, by_cycles: float, arm: Setup, seed: int) -> Poses:
    """Plateaus (K, 3) of an arm that softens as the bench's does, with other constants than the term has."""
    per_level = 40
    course = np.concatenate([np.zeros((1, 3)), np.repeat(levels_bar, per_level, axis=0)])
    effect = SofteningSection(
        type="softening", by_peak=by_peak, peak_bar=0.2, by_cycles=by_cycles, travel_bar=1.5
    ).effect(3, 0.05)
    felt = np.array([effect(row) for row in course.tolist()])
    time_s, last = 0.05 * np.arange(len(course)), per_level * np.arange(1, len(levels_bar) + 1)
    planned = replace(
        plan(name, levels_bar * PA, errors=ERRORS), history=pressure_history(time_s, course * PA, time_s[last])
    )
    return perform(planned, arm, np.random.default_rng(seed), ERRORS, felt_pa=felt[last] * PA)


def test_the_history_has_the_highest_pressure_and_the_way_so_far() -> None:
    time_s = np.arange(0.0, 40.0, 0.05)
    course = 1e5 * np.interp(time_s, [0, 10, 20, 30, 40], [0.0, 0.5, 0.2, 0.6, 0.6])[:, None]
    history = pressure_history(time_s, course, np.array([5.0, 10.0, 20.0, 30.0, 39.0]))
    assert history.highest_pa[:, 0] == pytest.approx(1e5 * np.array([0.25, 0.5, 0.5, 0.6, 0.6]), abs=1e3)
    assert history.travelled_pa[:, 0] == pytest.approx(1e5 * np.array([0.25, 0.5, 0.8, 1.2, 1.2]), abs=3e3)


def test_the_term_explains_the_softening_of_the_bench() -> None:
    levels = np.outer(UP_AND_DOWN, [1.0, 0.7, 0.0])
    poses = softened("cycle", levels, 0.05, 0.03, START, 1)
    term = next(one for one in TERMS if one.name == "softening")
    assert term.push is not None
    columns = term.push(poses, 0.6e5).reshape(-1, term.push(poses, 0.6e5).shape[2])
    effect = SofteningSection(type="softening", by_peak=0.05, peak_bar=0.2, by_cycles=0.03, travel_bar=1.5).effect(3, 1)
    felt = np.array([effect(row) for row in np.concatenate([np.zeros((1, 3)), levels]).tolist()])[1:]
    missing = ((felt - levels) * PA).ravel()
    left = missing - columns @ np.linalg.lstsq(columns, missing, rcond=None)[0]
    assert np.abs(left).max() < 0.03 * np.abs(missing).max()


def test_cycles_of_a_softening_arm_show_it() -> None:
    free, stated = ("law", "base"), stated_values(START, {})
    runs = {
        amount: [
            softened(f"cycle {k}", np.outer(UP_AND_DOWN, chambers), amount, 0.6 * amount, START, k)
            for k, chambers in enumerate(([1.0, 0.0, 0.0], [0.0, 1.0, 1.0]))
        ]
        for amount in (0.0, 0.05)
    }
    found = {}
    for amount, data in runs.items():
        fit = identify(data, START, free, stated=stated)
        assert fit.model_error is not None
        found[amount] = next(one for one in fit.model_error.effects if one.term.name == "softening")
    assert found[0.05].found
    assert found[0.05].mean == pytest.approx(0.08, rel=0.5)
    assert found[0.0].probability < 0.5
