"""Measured sections of the arm in the fit: slopes, error bars, and what they separate that the tip leaves open."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import model
from calibration.identify import Poses, Setup, identify
from calibration.identify.fitting.held_out_prediction import predict
from calibration.identify.observations.poses import split_at
from calibration.identify.simulated_experiments import MeasurementErrors, coverage, exact, perform, plan
from calibration.identify.unknowns.nuisance import nuisance_parameters, stated_values
from calibration.identify.unknowns.parameter import Prior
from calibration.identify.unknowns.section_mounts import mount_parameter, mount_priors
from calibration.identify.unknowns.setup import SectionMount
from tests.support.finite_differences import check_slopes, forward_of

BAR = 1e5
START = Setup(model.Arm.paper())
LENGTH = START.arm.geometry.length_m
SECTIONS = {"middle": 0.5 * LENGTH, "low": 0.27 * LENGTH}
RAMP = np.linspace(0.0, 0.65 * BAR, 12)[:, None]
ERRORS = MeasurementErrors((1e-4, 1e-4, 1e-4), 20.0, 0.0, section_m=(1e-4, 1e-4, 1e-4))
ORIENTED = replace(ERRORS, rotation_rad=math.radians(0.5))
MOVED = SectionMount("middle", (1e-3, -2e-3, 5e-4), (0.02, 0.01, -0.03))


def run_of(truth: Setup, errors: MeasurementErrors = ERRORS, period_s: float = 0.0, seed: int = 1) -> Poses:
    planned = plan("one", RAMP * [1, 0.3, 0], None, period_s, errors, SECTIONS)
    return perform(planned, truth, np.random.default_rng(seed), errors)


def without_sections(poses: Poses) -> Poses:
    return replace(poses, sections=())


@pytest.mark.parametrize("period_s", [0.0, 0.05])
def test_slopes_of_sections_are_the_finite_differences_of_the_gaps(period_s: float) -> None:
    poses = run_of(replace(START, sections=(MOVED,)), ORIENTED, period_s)
    names = ("a1_per_n", "shear_ratio", "length_m", "base", "tool", "sensor_offsets")
    mounts = ("section_middle_x_m", "section_middle_rz_rad", "section_low_y_m", "section_low_rx_rad")
    check_slopes(forward_of([poses], START, (*names, *mounts)), (12, 18))


def test_sections_tell_shear_from_bending_stiffness_and_mounting_and_the_tip_alone_does_not() -> None:
    poses = run_of(START)
    free = ("law", "shear_ratio", "base", "tool")
    tip = identify([without_sections(poses)], START, free)["shear_ratio"]
    sections = identify([poses], START, free)["shear_ratio"]
    assert sections.posterior_std < 0.8 * tip.posterior_std


def test_a_run_without_errors_is_fitted_exactly_and_says_which_sections_count() -> None:
    truth = replace(START, arm=START.arm.with_segment(material=replace(START.arm.material, a1_per_n=0.009)))
    planned = plan("one", RAMP * [1, 0.3, 0], errors=ORIENTED, sections_m=SECTIONS)
    fit = identify([exact(planned, truth)], START, ("a1_per_n",))
    assert fit["a1_per_n"].value == pytest.approx(0.009, rel=1e-5)
    assert fit.measured == 12 * 18
    low = {one.name: one for one in fit.runs[0].sections}["low"]
    assert (low.at_m, low.frames, low.oriented) == (SECTIONS["low"], 60, 60)
    assert low.rms_m < 1e-7
    assert low.rms_rad < 1e-5


@pytest.mark.slow
def test_error_bars_with_sections_hold_in_repeated_experiments() -> None:
    planned = [
        plan("one", RAMP * [1, 0, 0], errors=ORIENTED, sections_m=SECTIONS),
        plan("two", RAMP * [0, 1, 0.5], errors=ORIENTED, sections_m=SECTIONS),
    ]
    truth = replace(START, base_translation_m=(1e-3, 0.0, -5e-4))
    found = coverage(planned, truth, START, ("law", "base"), 10, ORIENTED, seed=3, workers=1)
    assert np.isfinite(found.z).mean() > 0.9
    # 80 intervals: two standard errors, of numbers that correlate within a trial.
    assert 0.87 <= found.overall <= 1.0


def test_a_board_that_is_glued_on_askew_moves_no_estimate_by_more_than_its_error_bar() -> None:
    fit = identify(
        [run_of(replace(START, sections=(MOVED,)), ORIENTED)], START, ("law",), stated=stated_values(START, {})
    )
    for name in ("a1_per_n", "a2_per_n2"):
        estimate = fit[name]
        assert estimate.std is not None
        assert abs(estimate.used - getattr(START.arm.material, name)) < 3 * estimate.std
    mount = fit["section_middle_y_m"]
    assert mount.nuisance
    assert mount.std is not None
    assert mount.used == pytest.approx(-2e-3, abs=3 * mount.std)
    assert mount.std < 1.5e-3


def test_the_stated_uncertainty_of_a_board_is_its_prior() -> None:
    stated = stated_values(START, {}) | {"section_middle_y_m": Prior(0.0, 1e-7)}
    fit = identify([run_of(START)], START, ("a1_per_n",), stated=stated)
    assert abs(fit["section_middle_y_m"].used) < 1e-6


def test_the_mounts_of_sections_are_nuisance_parameters_only_where_they_are_measured() -> None:
    def names(poses: Poses) -> set[str]:
        return {p.name for p in nuisance_parameters(START, [poses], ()) if p.name.startswith("section_")}

    assert names(without_sections(run_of(START))) == set()
    assert len(names(run_of(START))) == 6
    assert len(names(run_of(START, ORIENTED))) == 12
    assert set(mount_priors([run_of(START, ORIENTED)])) == names(run_of(START, ORIENTED))


@pytest.mark.parametrize("name", ["section_x_m", "section_middle_r_rad", "section_middle_w_m", "sectional_a_x_m"])
def test_another_name_is_no_mount(name: str) -> None:
    assert mount_parameter(name) is None


def test_entries_without_a_section_or_without_a_tip_fit_by_the_rest() -> None:
    poses = run_of(START)
    middle, low = poses.sections
    hidden = middle.point_m.copy()
    hidden[::2] = np.nan
    tips = poses.tip_m.copy()
    tips[0] = np.nan
    part = replace(poses, tip_m=tips, sections=(replace(middle, point_m=hidden), low))
    fit = identify([part], START, ("a1_per_n",))
    assert fit.measured == 3 * (11 + 6 + 11)
    assert [one.frames for one in fit.runs[0].sections] == [30, 55]


def test_runs_with_and_without_sections_are_fitted_together() -> None:
    fit = identify([run_of(START), without_sections(run_of(START, seed=2))], START, ("law",))
    assert [len(run.sections) for run in fit.runs] == [2, 0]
    assert fit["a1_per_n"].value == pytest.approx(START.arm.material.a1_per_n, rel=0.2)


def test_sections_count_only_on_their_side_of_a_split_and_are_predicted_on_the_other() -> None:
    whole = run_of(START)
    first, second = split_at(whole, float(whole.time_s[6]))
    fit = identify([first], START, ("a1_per_n",))
    assert fit.measured == 6 * 9
    found = predict(fit, second)
    assert [(one.name, one.frames) for one in found.sections] == [("middle", 30), ("low", 30)]
    assert all(one.rms_m < 1e-3 for one in found.sections)


def test_a_poor_prediction_of_one_section_is_a_discrepancy_of_that_section_alone() -> None:
    poses = run_of(START)
    middle, low = poses.sections
    noise = np.random.default_rng(0).normal(0, 2e-3, middle.point_m.shape)
    off = replace(poses, sections=(replace(middle, point_m=middle.point_m + noise), low))
    found = identify([off], START, ("a1_per_n",)).noise.extra
    assert found["section middle"] == pytest.approx(2e-3, rel=0.5)
    assert found["section low"] < 3e-4
    assert found["tip"] < 3e-4
