"""Errors of a fit on blocks of its own data: the linearised fit without a block is the fit without it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import model
from calibration.identify import Setup, identify
from calibration.identify.fitting.blocks_left_out import BLOCKS, blocks_left_out, left_out_variance
from calibration.identify.fitting.held_out_prediction import predict
from calibration.identify.simulated_experiments import MeasurementErrors, perform, plan
from calibration.identify.unknowns.parameter import Prior


def test_each_block_is_predicted_as_by_a_fit_to_the_others() -> None:
    rng = np.random.default_rng(1)
    pressure = np.random.default_rng(2).uniform(0, 0.5e5, (20, 3))
    start = Setup(model.Arm.paper())
    errors = MeasurementErrors((5e-4, 5e-4, 5e-4), 0, 0)
    data = perform(plan("run", pressure, np.zeros(20)), start, rng, errors)
    found = blocks_left_out(identify([data], start, ["a1_per_n", "base"]))[0]
    for block in range(BLOCKS):
        out = np.arange(20) * BLOCKS // 20 == block
        other = identify([data.only(~out)], start, ["a1_per_n", "base"])
        there = predict(other, replace(data.only(out), source="another"))
        assert found[out] == pytest.approx(there.measured_m - there.predicted_m, abs=1e-4)


def test_the_prior_of_a_free_parameter_counts_in_its_estimate() -> None:
    start = Setup(model.Arm.paper())
    softer = replace(start.arm.material, a1_per_n=1.2 * start.arm.material.a1_per_n)
    pressure = np.random.default_rng(3).uniform(0, 0.5e5, (12, 3))
    truth = replace(start, arm=start.arm.with_segment(material=softer))
    errors = MeasurementErrors((1e-3, 1e-3, 1e-3), 0, 0)
    data = perform(plan("run", pressure, np.zeros(12)), truth, np.random.default_rng(4), errors)
    a1 = start.arm.material.a1_per_n
    held = identify([data], start, ["a1_per_n"], {"a1_per_n": Prior(a1, 1e-6 * a1)})
    assert held["a1_per_n"].used == pytest.approx(a1, rel=1e-4)
    assert identify([data], start, ["a1_per_n"])["a1_per_n"].used > 1.1 * a1


def test_a_law_that_the_rod_lacks_widens_what_it_states_of_higher_pressures() -> None:
    start = Setup(model.Arm.paper())
    pressure = np.random.default_rng(5).uniform(0, 0.5e5, (60, 3))
    errors = MeasurementErrors((1e-4, 1e-4, 1e-4), 0, 0)
    data = perform(plan("run", pressure, np.zeros(60)), start, np.random.default_rng(6), errors)
    as_stated = left_out_variance(identify([data], start, ["a1_per_n", "base"]))
    assert as_stated.out_of_range_m2 < (1e-4) ** 2
    # The push grows faster than the pressure, which neither parameter can follow.
    squared = perform(plan("run", pressure**2 / 0.5e5, np.zeros(60)), start, np.random.default_rng(6), errors)
    other = replace(squared, pressure_pa=pressure)
    found = left_out_variance(identify([other], start, ["a1_per_n", "base"]))
    assert found.in_range_m2 > 25 * (1e-4) ** 2
    assert found.out_of_range_m2 > 1.5 * found.in_range_m2
