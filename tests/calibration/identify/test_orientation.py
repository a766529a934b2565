"""Orientations of the tip in the fit: what they determine, their error bars, and their absence."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import model
from calibration.identify import Poses, Setup, Verdict, identify, known
from calibration.identify.fitting.noise import RunNoise
from calibration.identify.observations.orientation import Orientations
from calibration.identify.observations.pressure_course import PressureCourse
from calibration.identify.prediction.tip_predictor import Predictor
from calibration.identify.simulated_experiments import MeasurementErrors, coverage, perform, plan
from calibration.identify.unknowns.nuisance import nuisance_parameters, stated_values
from model.dynamics import Dynamics
from model.material import MaxwellBranch
from tests.support.finite_differences import check_slopes, forward_of

BAR = 1e5
START = Setup(model.Arm.paper())
RAMP = np.linspace(0.0, 0.65 * BAR, 12)[:, None]
WITH = MeasurementErrors((1e-4, 1e-4, 1e-4), 20.0, 0.0, math.radians(0.5))
WITHOUT = replace(WITH, rotation_rad=None)
# A base that leans by nine degrees in the plane of the motion.
LEANING = replace(START, base_rotation_rad=(0.0, math.radians(9.0), 0.0), tool_offset_m=(0.015, 0.0, 0.01))
FREE = ("law", "tool", "base")


def run_of(truth: Setup, errors: MeasurementErrors, seed: int = 1, chambers: tuple[float, ...] = (1, 0, 0)) -> Poses:
    return perform(plan("one", RAMP * chambers, errors=errors), truth, np.random.default_rng(seed), errors)


def without_orientation(poses: Poses) -> Poses:
    return replace(poses, orientation=None)


def angle_deg(setup: Setup, poses: Poses) -> float:
    """Angle between the true and the fitted orientation of the last pose."""
    apart = Predictor(poses).rotations(setup)[-1] @ Predictor(poses).rotations(LEANING)[-1].T
    return math.degrees(Rotation.from_matrix(apart).magnitude())


def test_position_alone_hides_an_angle_that_the_orientation_shows() -> None:
    poses = run_of(LEANING, WITH)
    by_position = identify([without_orientation(poses)], START, FREE)
    assert not by_position["base_ry_rad"].identified
    assert by_position.rms_m < 1e-3
    assert math.isnan(by_position.rms_rad)

    fit = identify([poses], START, FREE)
    lean = fit["base_ry_rad"]
    assert lean.interval is not None
    assert lean.interval[0] < math.radians(9.0) < lean.interval[1]
    assert lean.std is not None
    assert lean.std < math.radians(0.5)
    assert by_position["base_ry_rad"].posterior_std > 5 * lean.std
    assert angle_deg(fit.setup, poses) < 0.5
    assert math.degrees(fit.rms_rad) == pytest.approx(0.5 * math.sqrt(3), rel=0.3)
    assert fit.noise.extra["tip rotation"] == 0
    assert fit.measured == 2 * by_position.measured


@pytest.mark.slow
def test_error_bars_with_orientations_hold_in_repeated_experiments() -> None:
    found = coverage(
        [plan("one", RAMP * [1, 0, 0], errors=WITH), plan("two", RAMP * [0, 1, 0.5], errors=WITH)],
        LEANING, START, ("law", "tool", "tool_rotation", "base"), 24, WITH, seed=3, workers=1,
    )  # fmt: skip
    assert np.isfinite(found.z).mean() > 0.9
    # 264 intervals: two standard errors, of numbers that correlate within a trial.
    assert 0.91 <= found.overall <= 0.99


@pytest.mark.parametrize("period_s", [0.0, 0.05])
def test_slopes_of_orientations_are_the_finite_differences_of_the_gaps(
    monkeypatch: pytest.MonkeyPatch, period_s: float
) -> None:
    # What Newton's method leaves of a step differs from one parameter to the next: here it leaves nothing.
    monkeypatch.setattr("model.dynamics.TOLERANCE_IN_MOTION", 1e-7)
    truth = replace(LEANING, tool_rotation_rad=(0.3, -0.2, 0.4))
    planned = plan("one", RAMP * [1, 0.3, 0], period_s=period_s, errors=WITH)
    poses = perform(planned, truth, np.random.default_rng(2), WITH)
    names = ("a1_per_n", "rpe_per_bar", "cap_mass_kg", "base", "tool", "tool_rotation", "sensor_offsets")
    check_slopes(forward_of([poses], START, names), (12, 6))


def test_the_tool_rotation_is_a_nuisance_parameter_only_where_orientations_are_measured() -> None:
    poses = run_of(START, WITH)
    names = {"tool_rx_rad", "tool_ry_rad", "tool_rz_rad"}
    assert names <= {p.name for p in nuisance_parameters(START, [poses], ())}
    assert not names & {p.name for p in nuisance_parameters(START, [without_orientation(poses)], ())}
    blind = identify([without_orientation(poses)], START, ("a1_per_n", "tool_rx_rad"))
    assert blind["tool_rx_rad"].verdict is Verdict.NO_EFFECT


def test_a_sensor_that_is_mounted_askew_by_some_degrees_moves_no_estimate_by_more_than_its_error_bar() -> None:
    askew = replace(START, tool_rotation_rad=(0.02, -0.03, 0.04))
    stated = stated_values(START, {})
    fit = identify([run_of(askew, WITH)], START, ("law", "base"), stated=stated)
    for name in ("a1_per_n", "a2_per_n2", "base_ry_rad"):
        estimate, truth = fit[name], known(3)[name].read(askew)
        assert estimate.std is not None
        assert abs(estimate.used - truth) < 3 * estimate.std


def test_entries_without_an_orientation_fit_by_their_position() -> None:
    poses = run_of(LEANING, WITH)
    assert poses.orientation is not None
    some = poses.orientation.rotation.copy()
    some[::2] = np.nan
    half = replace(poses, orientation=replace(poses.orientation, rotation=some))
    assert half.has_orientation.sum() == 6
    fit = identify([half], START, FREE)
    assert fit.measured == 36 + 18
    assert fit["base_ry_rad"].identified
    assert len(fit.runs[0].angle_rad) == 6
    none = replace(poses, orientation=replace(poses.orientation, rotation=np.full_like(some, np.nan)))
    plain = identify([without_orientation(poses)], START, FREE)
    same = identify([none], START, FREE)
    for one, other in zip(same.estimates, plain.estimates, strict=True):
        assert one.used == pytest.approx(other.used, abs=1e-2 * one.posterior_std), one.name


def test_a_wrong_orientation_moves_the_answer_by_less_than_an_error_bar() -> None:
    poses = run_of(LEANING, WITH)
    clean = identify([poses], START, FREE)
    assert poses.orientation is not None
    rotation = poses.orientation.rotation.copy()
    rotation[5] = Rotation.from_rotvec([0.0, 0.0, math.pi / 2]).as_matrix() @ rotation[5]
    spoiled = identify([replace(poses, orientation=replace(poses.orientation, rotation=rotation))], START, FREE)
    for one, other in zip(clean.estimates, spoiled.estimates, strict=True):
        if one.std is not None and other.value is not None:
            assert abs(one.used - other.value) < one.std, one.name
    assert spoiled.runs[0].outliers == clean.runs[0].outliers + 1


def test_tip_and_rotation_are_whitened_by_their_joint_covariance() -> None:
    rng = np.random.default_rng(4)
    root = rng.normal(0, 1, (5, 6, 6))
    joint = root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(6)
    measured = np.ones((5, 6), np.bool_)
    measured[2, 3:] = measured[4] = False
    noise = RunNoise(joint, measured)
    root = noise.whitened(np.broadcast_to(np.eye(6), (5, 6, 6)))
    for k, own in enumerate(joint):
        part = measured[k]
        expected = np.linalg.inv(own[np.ix_(part, part)])
        found = root[k].T @ root[k]
        np.testing.assert_allclose(found[np.ix_(part, part)], expected, rtol=1e-8)
        assert not found[~part].any()
    logs = [np.linalg.slogdet(2 * math.pi * own[np.ix_(p, p)])[1] for own, p in zip(joint, measured, strict=True)]
    assert noise.log_det == pytest.approx(sum(logs))


def test_a_subset_of_the_poses_keeps_its_orientations() -> None:
    poses = run_of(START, WITH)
    assert poses.orientation is not None
    part = poses.only(np.arange(3))
    assert isinstance(part.orientation, Orientations)
    np.testing.assert_array_equal(part.orientation.rotation, poses.orientation.rotation[:3])


def test_a_mounting_relative_to_another_one_measures_the_same_point_and_orientation() -> None:
    rng = np.random.default_rng(6)
    arm = model.Arm.paper()

    def drawn() -> Setup:
        x = rng.normal(0.0, 0.3, (4, 3)).tolist()
        return Setup(arm, *(tuple(row) for row in x))

    baseline, own = drawn(), drawn()
    tip_m, rotation = rng.normal(0.0, 0.2, (1, 3)), Rotation.from_rotvec([[0.3, -1.0, 0.4]]).as_matrix()
    whole = own.without_baseline(baseline)
    point_m, turned = whole.measured(tip_m, rotation)[0], whole.oriented(rotation)[0]
    # What a rig with the baseline in it makes of that: base and board are where the baseline says.
    base, tool = (Rotation.from_rotvec(v) for v in (baseline.base_rotation_rad, baseline.tool_rotation_rad))
    turned = (base.inv() * Rotation.from_matrix(turned) * tool.inv()).as_matrix()
    point_m = base.inv().apply(point_m - np.array(baseline.base_translation_m)) - turned @ baseline.tool_offset_m
    np.testing.assert_allclose(turned, own.oriented(rotation)[0], atol=1e-12)
    np.testing.assert_allclose(point_m, own.measured(tip_m, rotation)[0], atol=1e-12)


def on_a_course(truth: Setup) -> Poses:
    """Poses of an arm that remembers: one chamber is pressed, held, and released; four poses have an orientation."""
    rows = np.concatenate([np.linspace(0.0, 0.6, 8), np.full(12, 0.6), np.linspace(0.6, 0.1, 8)])[:, None] * BAR
    at = np.array([2, 7, 13, 19, 23, 27])
    pressure = rows * [1, 0.3, 0]
    empty = plan("course", pressure[at], errors=WITH)
    course = PressureCourse(0.25, pressure, np.zeros(len(rows)), np.zeros((len(rows), 6)), at)
    poses = perform(replace(empty, course=course), truth, np.random.default_rng(5), WITH)
    assert poses.orientation is not None
    return replace(poses, orientation=poses.orientation.without(np.isin(np.arange(6), [1, 4])))


RELAXING = replace(
    LEANING, arm=LEANING.arm.with_segment(material=replace(LEANING.arm.material, branches=(MaxwellBranch(0.3, 1.0),)))
)


def test_orientations_of_an_arm_that_remembers_are_those_of_its_course() -> None:
    poses = on_a_course(RELAXING)
    assert poses.course is not None
    predicted = Predictor(poses).rotations(RELAXING)
    # The same course as a motion, stepped through by the time scheme of the live model.
    still = replace(RELAXING.arm, inertia=False)
    dynamics = Dynamics(still, poses.course.period_s)
    turned = [dynamics.start(poses.course.pressure_pa[0]).tip_rotation]
    turned += list(dynamics.run(poses.course.pressure_pa[1:]).tip_rotation)
    np.testing.assert_allclose(predicted, RELAXING.oriented(np.array(turned)[poses.course.at]), atol=1e-7)
    # At one pressure the walls relax, so the tip turns on.
    relaxed_deg = math.degrees(Rotation.from_matrix(predicted[3] @ predicted[1].T).magnitude())
    assert relaxed_deg > 1.0


def test_on_a_course_only_poses_with_an_orientation_are_compared_by_it() -> None:
    poses = on_a_course(RELAXING)
    gap = Predictor(poses).gap(RELAXING)
    assert np.isfinite(gap[:, 3:]).all(axis=1).tolist() == [True, False, True, True, False, True]
    assert np.nanmax(np.abs(gap[:, 3:])) < 4 * math.radians(0.5)


def test_slopes_of_orientations_on_a_course_are_the_finite_differences_of_the_gaps() -> None:
    poses = on_a_course(RELAXING)
    names = ("a1_per_n", "branch_1_modulus", "branch_1_time_s", "base", "tool_rotation", "sensor_offsets")
    forward = forward_of([poses], RELAXING, names)
    theta = forward.first + np.linspace(-0.2, 0.2, len(forward.unknowns)) * forward.span
    slopes, known_rows = forward.slopes(theta)[0] * forward.span, poses.has_orientation
    for i, step in enumerate(np.diag(1e-4 * forward.span)):
        numerical = (forward.gaps(theta - step)[0] - forward.gaps(theta + step)[0])[known_rows] / 2e-4
        np.testing.assert_allclose(
            slopes[known_rows, :, i], numerical, atol=2e-5 * max(1.0, np.abs(numerical).max()), err_msg=str(i)
        )


def test_entries_spread_over_the_rows_of_a_course_keep_their_orientation() -> None:
    orientation = run_of(LEANING, WITH).orientation
    assert orientation is not None
    part = orientation.only(np.arange(3))
    spread = part.spread(np.array([1, 4, 5]), 7)
    np.testing.assert_array_equal(np.isfinite(spread.rotation).all(axis=(1, 2)), [0, 1, 0, 0, 1, 1, 0])
    for name in ("rotation", "covariance_rad2", "cross_m_rad"):
        np.testing.assert_array_equal(getattr(spread, name)[[1, 4, 5]], getattr(part, name))
