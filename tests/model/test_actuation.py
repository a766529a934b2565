"""Actuation laws: push pressures, their gradients, and the arm that they move at rest and in motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from model import Arm, Loads, batch, sensitivities
from model.actuation import ACTUATION_LAWS, OwnPressure, PressureSum, Proportional, actuation_law_named
from model.dynamics import Dynamics
from model.paper.rod import PaperRod
from model.statics import statics
from model.variation import Variation

BAR = 1e5
PRESSURES = np.array([0.5, 0.2, 0.05]) * BAR
GROWING = [OwnPressure(0.3), PressureSum(0.3)]


def arm(actuation=None, variant="homogeneous", **changed) -> Arm:  # type: ignore[no-untyped-def]
    return replace(Arm.paper(variant), actuation=actuation or Proportional(), **changed)


def test_push_pressures_follow_the_formulas() -> None:
    assert np.array_equal(Proportional().push_pa(PRESSURES), PRESSURES)
    assert OwnPressure(0.3).push_pa(PRESSURES) == pytest.approx(np.array([0.5 * 1.15, 0.2 * 1.06, 0.05 * 1.015]) * BAR)
    assert PressureSum(0.3).push_pa(PRESSURES) == pytest.approx(PRESSURES * 1.225)


def test_unknown_laws_and_misplaced_growth_are_refused() -> None:
    with pytest.raises(ValueError, match="proportional, own-pressure, pressure-sum"):
        actuation_law_named("square")
    with pytest.raises(ValueError, match="does not grow"):
        Proportional(0.1)
    with pytest.raises(ValueError, match="finite"):
        PressureSum(float("nan"))
    assert set(ACTUATION_LAWS) == {"proportional", "own-pressure", "pressure-sum"}


@pytest.mark.parametrize("variant", ["homogeneous", "inhomogeneous+rpe"])
@pytest.mark.parametrize("law", GROWING)
def test_equal_pressures_elongate_the_arm_as_the_closed_form_says(law, variant) -> None:  # type: ignore[no-untyped-def]
    pressure = np.full(3, 0.4 * BAR)
    built = arm(law, variant, cap_mass_kg=0.0)
    push = law.push_pa(pressure)[0] * built.geometry.chamber_area_m2
    material = built.material
    if variant == "homogeneous":
        strain = push / (material.youngs_modulus_pa * built.geometry.wall_area_m2)
    else:
        # The wall carries the push alone; the radial effect follows the pressure itself.
        strain = material.rpe_per_bar * 0.4 + material.a1_per_n * push + material.a2_per_n2 * push**2
    tip = statics(built, pressure).tip_m
    assert tip == pytest.approx([0, 0, built.geometry.length_m * (1 + strain)], abs=1e-10)


def test_without_growth_every_law_is_proportional() -> None:
    plain = Arm.paper()
    expected = statics(plain, PRESSURES).tip_m
    for law in (OwnPressure(0.0), PressureSum(0.0)):
        assert statics(replace(plain, actuation=law), PRESSURES).tip_m == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("law", GROWING)
def test_a_linear_wall_without_radial_effect_answers_to_push_pressures_alone(law) -> None:  # type: ignore[no-untyped-def]
    loads = Loads(tip_force_n=(0.05, 0.1, 0.0))
    grown = statics(arm(law), PRESSURES, loads).tip_m
    assert grown == pytest.approx(statics(arm(), law.push_pa(PRESSURES), loads, doubt_units=False).tip_m, abs=1e-10)


@pytest.mark.parametrize("variant", ["homogeneous+rpe"])
@pytest.mark.parametrize("law", GROWING)
def test_the_rod_of_the_paper_agrees(law, variant) -> None:  # type: ignore[no-untyped-def]
    built = arm(law, variant)
    assert statics(built, PRESSURES).tip_m == pytest.approx(PaperRod(built, 200).statics(PRESSURES).tip_m, abs=2e-6)


@pytest.mark.parametrize("variant", ["homogeneous", "inhomogeneous+rpe"])
@pytest.mark.parametrize("law", GROWING)
def test_gradients_by_growth_and_pressure_agree_with_finite_differences(law, variant) -> None:  # type: ignore[no-untyped-def]
    built, step = arm(law, variant), 1e-3
    grown = [replace(built, actuation=replace(law, growth_per_bar=0.3 + h)) for h in (1e-7, step, -step)]
    pressed = PRESSURES + np.array([0.01, 0.0, 0.0])
    changes = [Variation(1e-7, grown[0]), Variation(0.01, built, pressed[None])]
    found = sensitivities.statics(built, PRESSURES[None], changes)
    by_growth = (statics(grown[1], PRESSURES).tip_m - statics(grown[2], PRESSURES).tip_m) / (2 * step)
    one = np.array([100.0, 0.0, 0.0])
    by_pressure = (statics(built, PRESSURES + one).tip_m - statics(built, PRESSURES - one).tip_m) / 200
    assert found.tip_by[0, :, 0] == pytest.approx(by_growth, rel=2e-5, abs=1e-8)
    assert found.tip_by[0, :, 1] == pytest.approx(by_pressure, rel=2e-5, abs=2e-12)
    assert sensitivities.tip_gradient(built, PRESSURES).by_pressure[:, 0] == pytest.approx(
        by_pressure, rel=2e-5, abs=2e-12
    )


def test_the_gradient_by_growth_of_an_elongation_is_the_closed_form() -> None:
    pressure, law = np.full(3, 0.4 * BAR), PressureSum(0.3)
    built = arm(law, cap_mass_kg=0.0)
    geometry = built.geometry
    grown = Variation(1e-7, replace(built, actuation=PressureSum(0.3 + 1e-7)))
    found = sensitivities.statics(built, pressure[None], [grown])
    area = geometry.chamber_area_m2 / geometry.wall_area_m2
    expected = geometry.length_m * area * 0.4 * BAR * 1.2 / built.material.youngs_modulus_pa
    assert found.tip_by[0, :, 0] == pytest.approx([0, 0, expected], rel=1e-6, abs=1e-10)


@pytest.mark.parametrize("variant", ["homogeneous+rpe", "inhomogeneous+rpe"])
def test_the_gradient_of_a_motion_agrees_with_finite_differences(variant) -> None:  # type: ignore[no-untyped-def]
    law, step, dt_s = PressureSum(0.3), 1e-3, 1 / 30
    built = arm(law, variant)
    rows = np.outer(np.linspace(0, 0.5, 20), [1, 0.4, 0]) * BAR
    grown = [replace(built, actuation=PressureSum(0.3 + h)) for h in (1e-7, step, -step)]
    found = sensitivities.motion(built, rows, dt_s, [Variation(1e-7, grown[0])])
    high, low = batch.motions(grown[1:], np.stack([rows, rows]), dt_s)
    assert found.tip_m[1:] == pytest.approx(batch.motions(built, rows[None], dt_s)[0].tip_m, abs=1e-9)
    assert found.tip_by[1:, :, 0] == pytest.approx((high.tip_m - low.tip_m) / (2 * step), abs=2e-7)


def test_one_step_at_a_time_moves_the_arm_as_one_call_does() -> None:
    built = arm(PressureSum(0.3), "inhomogeneous+rpe")
    rows = np.outer(np.linspace(0, 0.5, 15), [1, 0, 0.5]) * BAR
    whole, single = Dynamics(built, 1 / 30), Dynamics(built, 1 / 30)
    for one in (whole, single):
        one.start(rows[0])
    tips = [single.step(row).tip_m for row in rows[1:]]
    assert np.array_equal(whole.run(rows[1:]).tip_m, tips)


def test_a_batch_agrees_with_single_solutions_for_one_arm_and_for_one_arm_a_row() -> None:
    rows = np.array([[0.5, 0.2, 0.0], [0.1, 0.4, 0.3]]) * BAR
    arms = [arm(PressureSum(k), "inhomogeneous+rpe") for k in (0.2, 0.4)]
    single = [statics(one, row).tip_m for one, row in zip(arms, rows, strict=True)]
    assert batch.statics(arms, rows).tip_m == pytest.approx(np.array(single), abs=1e-9)
    assert batch.statics(arms[0], rows).tip_m[0] == pytest.approx(single[0], abs=1e-9)
    with pytest.raises(ValueError, match="laws"):
        batch.statics([arms[0], arm(None, "inhomogeneous+rpe")], rows)
