"""Measured sections of the arm in the recursive estimator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import model
from calibration.identify import Setup, named
from calibration.identify.observations.poses import Poses
from calibration.identify.recursive_estimator import RecursiveEstimator, SectionMeasurements
from calibration.identify.simulated_experiments import MeasurementErrors, perform, plan
from calibration.identify.unknowns.parameter import Prior
from calibration.identify.unknowns.setup import SectionMount

pytestmark = pytest.mark.slow


BAR = 1e5
START = Setup(model.Arm.paper())
LENGTH = START.arm.geometry.length_m
SECTIONS = {"middle": 0.5 * LENGTH, "low": 0.27 * LENGTH}
ERRORS = MeasurementErrors((1e-4, 1e-4, 1e-4), 20.0, 0.0, section_m=(1e-4, 1e-4, 1e-4))
FREE = ("law", "rpe_per_bar", "base", "tool")
MOVED = SectionMount("middle", (1e-3, -2e-3, 5e-4))


def poses_of(truth: Setup, seed: int = 1) -> Poses:
    rng = np.random.default_rng(seed)
    levels = rng.uniform(0.05, 0.6, (40, 3)) * BAR
    return perform(plan("one", levels, None, 0.0, ERRORS, SECTIONS), truth, rng, ERRORS)


def sections_of(poses: Poses, k: int) -> SectionMeasurements:
    return SectionMeasurements(
        np.array([one.point_m[k] for one in poses.sections]),
        np.array([one.covariance_m2[k] for one in poses.sections]),
        np.zeros((len(poses.sections), 3)),
    )


def estimated(
    poses: Poses, *, sections: bool = True, free: tuple[str, ...] = FREE, priors: dict[str, Prior] | None = None
) -> RecursiveEstimator:
    estimator = RecursiveEstimator(
        START, free, priors, floor_m=0.0, repeats=1.0, sections_m=SECTIONS if sections else None
    )
    for k in range(len(poses)):
        along = sections_of(poses, k) if sections else None
        estimator.step(poses.pressure_pa[k], poses.tip_m[k], poses.covariance_m2[k], sections=along)
    return estimator


def test_sections_tell_the_base_from_the_mounting_of_the_tip() -> None:
    poses = poses_of(START)
    tip, both = estimated(poses, sections=False), estimated(poses)
    assert both.names == tip.names
    assert both.covariance.shape == (12, 12)
    assert (both.std <= tip.std * (1 + 1e-9)).all()
    for name in ("base_x_m", "base_y_m", "base_z_m", "base_rx_rad", "base_ry_rad", "tool_z_m"):
        k = tip.names.index(name)
        assert both.std[k] < 0.75 * tip.std[k]


def test_the_intervals_hold_the_truth_though_a_board_is_glued_on_askew() -> None:
    material = replace(START.arm.material, a1_per_n=1.05 * START.arm.material.a1_per_n)
    arm = START.arm.with_segment(material=material)
    truth = replace(START, arm=arm, sections=(MOVED,), base_rotation_rad=(0.01, 0.0, 0.0))
    true = np.array([p.read(truth) for p in named(FREE, 3)])
    z = np.array([(one.values - true) / one.std for one in (estimated(poses_of(truth, seed)) for seed in (1, 2, 3))])
    assert (np.abs(z) < 3.5).all()
    assert 0.5 < np.sqrt((z**2).mean()) < 1.4


def test_a_board_whose_offset_is_free_is_estimated() -> None:
    names = ("section_middle_x_m", "section_middle_y_m", "section_middle_z_m")
    found = estimated(poses_of(replace(START, sections=(MOVED,))), free=names)
    assert found.names == names
    np.testing.assert_allclose(found.values, MOVED.offset_m, atol=2e-4)


def test_the_stated_uncertainty_of_a_board_is_its_prior() -> None:
    poses = poses_of(START)
    exact = {f"section_{name}_{axis}_m": Prior(0.0, 1e-6) for name in SECTIONS for axis in "xyz"}
    assert (estimated(poses, priors=exact).std < estimated(poses).std).all()


def test_a_section_that_is_not_measured_is_left_out() -> None:
    poses = poses_of(START)
    hidden = [replace(one, point_m=np.full_like(one.point_m, np.nan)) for one in poses.sections]
    unseen = estimated(replace(poses, sections=tuple(hidden)))
    tip = estimated(poses, sections=False)
    np.testing.assert_allclose(unseen.values, tip.values, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(unseen.std, tip.std, rtol=1e-9)


def test_an_outlying_section_is_down_weighted_and_the_tip_is_not() -> None:
    poses = poses_of(START)
    estimator = estimated(poses)
    before = estimator.values
    wrong = sections_of(poses, 0)
    wrong.point_m[0] += 0.5
    done = estimator.step(poses.pressure_pa[0], poses.tip_m[0], poses.covariance_m2[0], sections=wrong)
    assert (done.used, done.damped) == (True, True)
    assert (np.abs(estimator.values - before) < 3 * estimator.std).all()


def test_the_sections_of_a_frame_are_predicted_as_the_tip_is() -> None:
    truth = replace(START, sections=(MOVED,))
    poses = poses_of(truth)
    estimator = estimated(poses)
    done = estimator.step(poses.pressure_pa[3], poses.tip_m[3], poses.covariance_m2[3], sections=sections_of(poses, 3))
    assert np.abs(done.sections_m - sections_of(poses, 3).point_m).max() == pytest.approx(0.0, abs=5e-4)


def test_the_direction_of_gravity_is_estimated() -> None:
    turned = replace(START, gravity_turn_rad=(0.03, 0.0, 0.0))
    found = estimated(poses_of(turned), sections=False, free=("gravity_rx_rad", "gravity_ry_rad"))
    np.testing.assert_allclose(found.values, (0.03, 0.0), atol=4 * found.std.max())
    assert found.std.max() < 0.01
