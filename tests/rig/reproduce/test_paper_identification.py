"""The paper's identification (5.2): known lines come back, and the printed E is explained."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import model
from calibration.identify.errors import NoDataError
from calibration.identify.simulated_experiments import MeasurementErrors, perform, plan
from calibration.identify.unknowns.setup import Setup
from model.paper.identification import identify_paper, line, published_modulus, softening
from rig.reproduce.elongation import elongation

EXACT = MeasurementErrors((1e-9, 1e-9, 1e-9), 0.0, 0.0)


def test_the_published_polynomial_gives_290_5_kpa_through_the_origin() -> None:
    found = published_modulus()
    assert found.through_origin_pa == pytest.approx(290.5e3, rel=2e-4)
    assert "290.5" in found.explanation


def test_raw_data_with_the_constant_that_polyfit_fits_give_the_printed_modulus_and_the_printed_polynomial() -> None:
    # The explanation, played through: data whose best parabola has this constant and the printed coefficients.
    found, paper = published_modulus(), model.Material.paper()
    force = np.linspace(0.1, 1.2, 12) * 9.81
    raw = found.constant + paper.a1_per_n * force + paper.a2_per_n2 * force**2
    wiggle = np.sin(3 * force)
    wiggle -= np.polyval(np.polyfit(force, wiggle, 2), force)
    raw = raw + 2e-4 * wiggle
    a2, a1, a0 = np.polyfit(force, raw, 2)
    assert (a1, a2) == pytest.approx((paper.a1_per_n, paper.a2_per_n2), rel=1e-9)
    assert f"{1 + a0:.3f}" == "1.000"
    area = model.Geometry.paper().wall_area_m2
    assert 1 / (area * line(force, raw).slope) == pytest.approx(289142.05, rel=1e-6)


def test_force_and_strain_of_an_arm_under_weights_give_its_own_law() -> None:
    arm = model.Arm.paper()
    weights = np.linspace(0, 1.2, 13)
    poses = perform(plan("w", np.zeros((13, 3)), weights), Setup(arm), np.random.default_rng(0), EXACT)
    under = elongation(poses, arm.geometry.length_m)
    found = softening(under.force_n, under.strain)
    # Strain counts from the arm with its 50 g cap, so a1 is the tangent there.
    cap_n = 0.05 * 9.81 / 3
    assert found.a2_per_n2 == pytest.approx(arm.material.a2_per_n2, rel=1e-3)
    assert found.a1_per_n == pytest.approx(arm.material.a1_per_n + 2 * cap_n * arm.material.a2_per_n2, rel=1e-3)
    assert found.r2 > 0.999999


def test_the_free_strain_of_an_arm_is_identified_from_both_extension_experiments() -> None:
    arm = replace(model.Arm.paper(), cap_mass_kg=0.0)
    rng, setup = np.random.default_rng(0), Setup(arm)
    ramp = np.concatenate([[0.0], np.linspace(0.15e5, 0.65e5, 6)])[:, None] * np.ones(3)
    weights = elongation(perform(plan("w", np.zeros((7, 3)), np.linspace(0, 1.2, 7)), setup, rng, EXACT), 0.17)
    pressure = elongation(perform(plan("p", ramp), setup, rng, EXACT), 0.17)
    found = identify_paper(weights, pressure, arm.geometry)
    assert found.rpe_measured.slope == pytest.approx(arm.material.rpe_per_bar, rel=1e-3)
    assert found.softening.a1_per_n == pytest.approx(arm.material.a1_per_n, rel=1e-3)


def test_plateaus_under_a_measured_force_are_no_elongation_by_weights() -> None:
    arm = model.Arm.paper()
    weights = np.linspace(0, 1.2, 7)
    poses = perform(plan("w", np.zeros((7, 3)), weights), Setup(arm), np.random.default_rng(0), EXACT)
    wrench = np.zeros((7, 6))
    wrench[[0, 3], 0] = 0.5, 1e-3
    with pytest.raises(NoDataError, match="no plateau without pressure, weight and measured force"):
        elongation(replace(poses, wrench=wrench), arm.geometry.length_m)
    wrench[0], wrench[5, 2] = 0.0, -0.5
    under = elongation(replace(poses, wrench=wrench), arm.geometry.length_m)
    assert under.force_n * 3 / 9.81 == pytest.approx(weights[[1, 2, 3, 4, 6]], rel=1e-3)


def test_elongation_needs_an_unloaded_plateau() -> None:
    poses = perform(
        plan("w", np.zeros((3, 3)), np.array([0.1, 0.2, 0.3])), Setup(model.Arm.paper()), np.random.default_rng(0)
    )
    with pytest.raises(NoDataError, match="no plateau without pressure, weight and measured force"):
        elongation(poses, 0.17)
