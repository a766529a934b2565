"""Expected error bars against finite differences and against those that an identification states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calibration.design.information import UnknownsOfDesign, error_bars, error_bars_of_repeats
from calibration.identify import Prior, Setup, identify, named
from calibration.identify.simulated_experiments import MeasurementErrors, exact, perform, plan
from calibration.identify.unknowns.nuisance import nuisance_parameters, stated_values
from calibration.identify.unknowns.section_mounts import mount_priors
from rig.config.arm_model import model_arm
from rig.config.loader import load

FREE = ("rpe_per_bar", "a1_per_n", "base_x_m", "sensor_1_offset_pa")
PRIORS = {"sensor_1_offset_pa": Prior(0.0, 200.0)}
ERRORS = MeasurementErrors(tip_m=(5e-5, 5e-5, 5e-5), pressure_pa=10.0, offset_pa=0.0)
PRESSURES = 1e5 * np.array([[p, q, q] for p in (0.1, 0.3, 0.6) for q in (0.1, 0.35, 0.6)])


@pytest.fixture(scope="module")
def unknowns() -> UnknownsOfDesign:
    return UnknownsOfDesign(Setup(model_arm(load("mock"))), named(FREE, 3), (), PRIORS)


def test_the_covariance_is_that_of_finite_differences_of_the_predictions(unknowns: UnknownsOfDesign) -> None:
    objective = unknowns.objective([plan("levels", PRESSURES, errors=ERRORS)])
    forward = objective.forward
    columns = []
    for step in np.diag(1e-3 * forward.span):
        change = forward.predicted(forward.first + step)[0] - forward.predicted(forward.first - step)[0]
        columns.append(objective.noise.runs[0].whitened(change / (2 * step.sum())).ravel())
    slope = np.array(columns).T
    expected = np.linalg.inv(slope.T @ slope + np.diag(forward.std**-2))
    np.testing.assert_allclose(objective.covariance(forward.first), expected, rtol=1e-2)


def test_expected_error_bars_are_those_that_the_identification_states(unknowns: UnknownsOfDesign) -> None:
    planned = plan("levels", PRESSURES, errors=ERRORS)
    expected = error_bars([planned], unknowns)
    fit = identify([perform(planned, unknowns.start, np.random.default_rng(1), ERRORS)], unknowns.start, FREE, PRIORS)
    stated = [fit[name].std for name in expected.names]
    assert expected.names == FREE[:3]
    np.testing.assert_allclose(expected.std, stated, rtol=0.15)


@pytest.mark.slow
def test_measured_sections_narrow_the_expected_error_bars_as_those_of_the_identification() -> None:
    free, errors = ("a1_per_n", "base_x_m", "base_z_m"), replace(ERRORS, section_m=(5e-5, 5e-5, 5e-5))
    start = Setup(model_arm(load("mock")))
    tip = plan("one", PRESSURES, errors=errors)
    both = plan("one", PRESSURES, errors=errors, sections_m={"middle": 0.5 * start.arm.geometry.length_m})
    bars = []
    for planned in (tip, both):
        chosen = named(free, 3)
        beside = nuisance_parameters(start, [exact(planned, start)], chosen)
        stated = stated_values(start, {}) | mount_priors([planned])
        bars.append(
            error_bars([planned], UnknownsOfDesign(start, chosen, beside, {p.name: stated[p.name] for p in beside}))
        )
    assert (bars[1].std[1:] < 0.8 * bars[0].std[1:]).all()
    fit = identify([exact(both, start)], start, free, stated=stated)
    np.testing.assert_allclose([fit[name].std for name in free], bars[1].std, rtol=0.15)


def test_planned_tips_are_exact_at_the_time_steps_of_the_fit() -> None:
    """Fine tips would take the difference between two step sizes for an error of the model."""
    start = Setup(model_arm(load("mock")))
    shake = 1e5 * (0.4 + 0.05 * np.sin(2 * np.pi * 5 * np.arange(30) / 30.0))[:, None] * np.ones(3)
    damped = UnknownsOfDesign(start, named(("damping_s",), 3), (), {})
    forward = damped.objective([plan("shake", shake, period_s=1 / 30, errors=ERRORS)]).forward
    assert forward.substeps > 2
    assert np.abs(forward.gaps(forward.first)[0]).max() == 0.0


def test_a_hundred_repeats_make_bars_that_measurement_decides_ten_times_smaller(unknowns: UnknownsOfDesign) -> None:
    free_of_offsets = UnknownsOfDesign(unknowns.start, unknowns.free[:3], (), {})
    once, often = error_bars_of_repeats([plan("levels", PRESSURES, errors=ERRORS)], free_of_offsets, (1.0, 100.0))
    np.testing.assert_allclose(often.std, once.std / 10, rtol=0.02)


def test_twice_the_data_make_the_error_bars_smaller_by_root_two(unknowns: UnknownsOfDesign) -> None:
    free_of_offsets = UnknownsOfDesign(unknowns.start, unknowns.free[:3], (), {})
    once = error_bars([plan("levels", PRESSURES, errors=ERRORS)], free_of_offsets)
    twice = error_bars([plan(name, PRESSURES, errors=ERRORS) for name in ("first", "second")], free_of_offsets)
    np.testing.assert_allclose(twice.std, once.std / np.sqrt(2), rtol=0.02)
