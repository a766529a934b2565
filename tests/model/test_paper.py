"""The paper's own formulation agrees with the consistent one, and each erratum of the paper shows."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from model import Arm, Geometry, Loads, Material
from model.dynamics import Dynamics
from model.paper.moduli import MODULUS_RULES, frozen_stiffness_n
from model.paper.rod import NeutralSection, PaperRod
from model.schemes import scheme_named
from model.statics import statics
from tests.support.budget import examples
from tests.support.linear_rod import linear_rod_tip

BAR = 1e5
ARM = Arm.paper()


def test_the_arm_has_the_measures_of_table_1() -> None:
    g = Geometry.paper()
    assert (g.inner_radius_m, g.outer_radius_m, g.length_m) == (0.0095, 0.014, 0.170)
    apart = [math.dist(one, other) for one, other in combinations(g.actuator_xy_m, 2)]
    assert apart == pytest.approx([0.055] * 3)
    # Actuator 1 lies on the x axis, 120 degrees from the others.
    assert [math.degrees(math.atan2(y, x)) for x, y in g.actuator_xy_m] == pytest.approx([0, 120, -120])


@pytest.mark.parametrize(
    ("name", "alpha", "printed"),
    [
        ("bdf1", 0.0, (1, -1, 0, 0, 0)),
        ("bdf3", 0.0, (11 / 6, -3, 3 / 2, -1 / 3, 0)),
        *(("bdf-alpha", a, ((1.5 + a) / (1 + a), -2, (0.5 + a) / (1 + a), 0, a / (1 + a))) for a in (-0.1, -0.3)),
        ("bdf2", 0.0, (1.5, -2, 0.5, 0, 0)),
        ("trapezoidal", 0.0, (2, -2, 0, 0, -1)),
    ],
)
def test_the_schemes_have_the_coefficients_of_table_2(name: str, alpha: float, printed: tuple[float, ...]) -> None:
    dt, c = 1 / 30, scheme_named(name).coefficients(1 / 30, alpha)
    found = (c.c0 * dt, c.c1 * dt, c.c2 * dt, c.c3 * dt, c.d1)
    assert found == pytest.approx(printed)


@pytest.mark.parametrize("rule", ["paper-secant", "paper-tangent"])
@pytest.mark.parametrize("bar", [(0.65, 0, 0), (0, 0.5, 0.5), (0, 0, 0)])
@given(noise_pa=st.tuples(*[st.integers(-1000, 1000)] * 3))
@examples(20)
def test_a_passive_tube_stays_passive_under_the_sensors_noise(
    rule: str, bar: tuple[float, ...], noise_pa: tuple[int, ...]
) -> None:
    # The paper's sensor is good to 0.01 bar; its n on a passive tube is an even share of what the others push.
    arm = ARM
    clean = np.array(bar) * BAR
    read = clean + np.array(noise_pa)
    passive = clean == 0
    share = (read[~passive] * arm.geometry.chamber_area_m2).sum() / passive.sum()
    alone = "secant" if rule == "paper-secant" else "tangent"
    like = np.where(passive, share / arm.geometry.chamber_area_m2, read)
    assert np.allclose(frozen_stiffness_n(arm, read, rule), frozen_stiffness_n(arm, like, alone), rtol=1e-12)
    rod = PaperRod(arm, modulus_rule=rule)
    assert np.abs(rod.statics(read).tip_m - rod.statics(clean).tip_m).max() < 5e-3


@pytest.mark.parametrize("bar", [(0.65, 0, 0), (0, 0.65, 0.65), (0.65, 0.3, 0.1)])
@pytest.mark.parametrize("rpe_as", ["force", "strain"])
@pytest.mark.parametrize("solver", ["lm", "dogleg"])
@pytest.mark.parametrize("rule", MODULUS_RULES)
def test_the_neutral_axis_with_frozen_moduli_agrees_with_the_central_axis_at_rest(
    rule: str, solver: str, rpe_as: str, bar: tuple[float, ...]
) -> None:
    p = np.array(bar) * BAR
    rod = PaperRod(ARM, steps=100, solver=solver, modulus_rule=rule, rpe_as=rpe_as)  # type: ignore[arg-type]
    printed = rod.statics(p)
    tip, turned = linear_rod_tip(ARM, p, frozen_stiffness_n(ARM, p, rule), rpe_as)
    assert np.abs(printed.tip_m - tip).max() < 1e-9
    assert np.abs(printed.tip_rotation - turned).max() < 1e-8


@pytest.mark.parametrize("bar", [(0.65, 0, 0), (0, 0.65, 0.65), (0.65, 0.3, 0.1)])
@pytest.mark.parametrize("solver", ["lm", "dogleg"])
@pytest.mark.parametrize("variant", ["homogeneous", "homogeneous+rpe"])
def test_both_formulations_agree_at_rest(variant: str, solver: str, bar: tuple[float, ...]) -> None:
    arm, p = Arm.paper(variant), np.array(bar) * BAR
    printed = PaperRod(arm, steps=100, solver=solver).statics(p)  # type: ignore[arg-type]
    ours = statics(arm, p, nodes=100)
    assert np.abs(printed.p_m - ours.p_m).max() < 1e-9
    assert np.abs(printed.rotation - ours.rotation).max() < 1e-8
    assert np.abs(printed.v - ours.v).max() < 1e-8
    assert np.abs(printed.u - ours.u).max() < 1e-6


@examples(15)
@given(st.tuples(*[st.floats(0, 0.65)] * 3), st.tuples(*[st.floats(-0.5, 0.5)] * 3))
def test_both_formulations_agree_under_any_end_load(bar: tuple[float, ...], force: tuple[float, ...]) -> None:
    # Erratum: eq 25 forgets the external wrench that eq 28 has.
    arm = replace(Arm.paper("homogeneous+rpe"))
    loads = Loads(tip_force_n=force, tip_moment_n_m=(0.01, 0.02, -0.01), force_n_per_m=(0.5, 0, 0))
    p = np.array(bar) * BAR
    assert np.abs(PaperRod(arm, steps=60).statics(p, loads).tip_m - statics(arm, p, loads, 60).tip_m).max() < 1e-8


@pytest.mark.parametrize("scheme", ["bdf1", "bdf2", "bdf-alpha", "bdf3", "trapezoidal"])
def test_both_formulations_agree_in_motion(scheme: str) -> None:
    arm = Arm.paper("homogeneous+rpe")
    paper, ours = PaperRod(arm, 1 / 30, scheme, steps=100), Dynamics(arm, 1 / 30, scheme, nodes=40)
    paper.start((0.3 * BAR, 0, 0))
    ours.start((0.3 * BAR, 0, 0))
    for k in range(10):
        p = np.array([0.3 + 0.1 * math.sin(k / 5), 0.05 * math.sin(k / 3) ** 2, 0]) * BAR
        assert np.abs(paper.step(p).tip_m - ours.step(p).tip_m).max() < 1e-6


def test_both_formulations_agree_in_motion_of_two_tubes_off_the_axes() -> None:
    # Then the section's own axes of inertia are not x and y.
    arm = Arm.paper("homogeneous+rpe").with_segment(
        geometry=Geometry.on_circle(0.1, 0.0095, 0.014, 0.06, (35.0, 215.0))
    )
    paper, ours = PaperRod(arm, 1 / 30, steps=100), Dynamics(arm, 1 / 30, nodes=40)
    paper.start((0, 0))
    ours.start((0, 0))
    for k in range(8):
        p = np.array([0.3, 0.05 * k]) * BAR
        assert np.abs(paper.step(p).tip_m - ours.step(p).tip_m).max() < 1e-6


@pytest.mark.parametrize("change", [{"cap_inertia": True}, {"damping_s": 0.01}])
def test_options_that_the_papers_formulation_lacks_in_motion_are_refused(change: dict[str, object]) -> None:
    arm = Arm.paper("homogeneous")
    if "damping_s" in change:
        arm = arm.with_segment(material=replace(arm.material, **change))  # type: ignore[arg-type]
    else:
        arm = replace(arm, **change)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"model\.dynamics\.Dynamics"):
        PaperRod(arm).start((0, 0, 0))


def test_a_force_beside_the_axis_is_refused_by_the_papers_formulation() -> None:
    with pytest.raises(ValueError, match="tip_point_m"):
        PaperRod(Arm.paper("homogeneous")).statics((0, 0, 0), Loads(tip_force_n=(1, 0, 0), tip_point_m=(0, 0, 0.01)))


@pytest.mark.parametrize(("space", "order"), [("euler", 1), ("rk4", 4)])
def test_the_spatial_methods_have_their_orders(space: str, order: int) -> None:
    arm = replace(Arm.paper("homogeneous+rpe"), rod_weight=True)
    p = np.array([0.65, 0.2, 0.0]) * BAR
    exact = statics(arm, p, nodes=200).tip_m
    errors = [
        np.abs(PaperRod(arm, space=space, steps=n).statics(p).tip_m - exact).max()  # type: ignore[arg-type]
        for n in (8, 16)
    ]
    assert math.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.3)


def test_a_linear_history_at_the_mid_points_drops_rk4_to_second_order() -> None:
    # Why the live solver keeps a cubic one.
    arm = Arm.paper("homogeneous+rpe")

    def tip(steps: int) -> np.ndarray:
        rod = PaperRod(arm, 0.005, steps=steps)
        rod.start((0.1 * BAR, 0, 0))
        for k in range(1, 11):
            shape = rod.step(((0.1 + 0.02 * k) * BAR, 0, 0))
        return shape.tip_m

    exact = tip(160)
    ratio = np.abs(tip(10) - exact).max() / np.abs(tip(20) - exact).max()
    assert math.log2(ratio) == pytest.approx(2.0, abs=0.5)


def test_a_step_that_shooting_cannot_solve_is_flagged() -> None:
    rod = PaperRod(Arm.paper("homogeneous"))
    rod.statics((0, 0, 0))
    with pytest.raises(ValueError, match="start"):
        rod.step((0, 0, 0))
    good = rod.start((0.1 * BAR, 0, 0))
    bad = rod.step((1e12, 0, 0))
    assert not bad.ok
    assert np.array_equal(bad.p_m, good.p_m)
    assert rod.step((0.1 * BAR, 0, 0)).ok


@pytest.mark.parametrize(
    "wrong", [{"space": "midpoint"}, {"solver": "bfgs"}, {"steps": 0}, {"scheme": "rk4"}, {"dt_s": -1.0}]
)
def test_a_method_that_the_paper_does_not_have_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"unknown|step"):
        PaperRod(Arm.paper("homogeneous"), **wrong)  # type: ignore[arg-type]


def test_the_pointwise_section_has_no_neutral_axis_of_the_papers_kind() -> None:
    with pytest.raises(ValueError, match="modulus_rule"):
        PaperRod(Arm.paper()).statics((0, 0, 0))


def test_erratum_a_stretch_put_in_as_a_strain_pushes_with_96_newtons_at_no_pressure() -> None:
    arm = Arm.paper("homogeneous+rpe")
    printed = NeutralSection.of(arm, np.zeros(3), as_printed=frozenset({"stretch as strain"}))
    assert printed.push_n == pytest.approx([96.0] * 3, abs=0.2)
    assert NeutralSection.of(arm, np.zeros(3)).push_n == pytest.approx([0, 0, 0])


def test_erratum_the_strain_at_an_actuator_is_v3_plus_y_u1_minus_x_u2() -> None:
    # Geometry alone: move along the actuator's own line and compare with both signs.
    arm = Arm.paper("homogeneous")
    shape = statics(arm, (0.65 * BAR, 0.2 * BAR, 0), nodes=400)
    x, y = arm.geometry.actuator_xy_m[1]
    line = shape.p_m + shape.rotation @ np.array([x, y, 0.0])
    length = np.linalg.norm(np.diff(line, axis=0), axis=1).sum()
    v3, u1, u2 = shape.v[:, 2], shape.u[:, 0], shape.u[:, 1]
    right = np.trapezoid(v3 + y * u1 - x * u2, shape.s_m)
    printed = np.trapezoid(v3 + x * u1 + y * u2, shape.s_m)
    assert length == pytest.approx(right, rel=1e-4)
    assert abs(length - printed) > 0.005


def test_erratum_the_sign_of_k12_matters_as_soon_as_three_pressures_differ() -> None:
    right_rod = PaperRod(ARM, modulus_rule="tangent")
    wrong_rod = PaperRod(ARM, modulus_rule="tangent", as_printed=frozenset({"K12"}))
    for bar in ((0.65, 0, 0), (0, 0.65, 0.65)):
        p = np.array(bar) * BAR
        assert np.abs(wrong_rod.statics(p).tip_m - right_rod.statics(p).tip_m).max() < 1e-9
    apart = []
    for bar in ((0.65, 0.3, 0.1), (0.6, 0.0, 0.4), (0.0, 0.3, 0.65)):
        p = np.array(bar) * BAR
        apart.append(np.linalg.norm(right_rod.statics(p).tip_m - wrong_rod.statics(p).tip_m))
    assert min(apart) > 0.002
    assert max(apart) < 0.03


def test_erratum_the_cross_stiffness_follows_from_the_energy() -> None:
    # m1 by u2 is -sum E_i A x_i y_i: stretch by u2 alone is -x u2, its moment about x is y times the force.
    p = np.array([0.65, 0.3, 0.1]) * BAR
    known = NeutralSection.of(ARM, p, "secant")
    stiffness = frozen_stiffness_n(ARM, p, "secant")
    x, y, _ = known.arms_m.T
    assert known.bending_torsion[0, 1] == pytest.approx((y * stiffness * -x).sum())
    printed = NeutralSection.of(ARM, p, "secant", as_printed=frozenset({"K12"}))
    assert printed.bending_torsion[0, 1] == pytest.approx(-known.bending_torsion[0, 1])


def test_erratum_each_tube_bends_about_its_own_axis_with_its_own_modulus() -> None:
    # With equal moduli eq 21 must return eq 16, I_xx = 3 I_o + A_m b^2 / 2; one E I_o falls short.
    g, m = Geometry.paper(), Material.paper()
    known = NeutralSection.of(Arm.paper("homogeneous"), np.zeros(3))
    homogeneous = m.youngs_modulus_pa * (3 * g.wall_second_moment_m4 + g.wall_area_m2 * 0.055**2 / 2)
    assert np.diag(known.bending_torsion)[:2] == pytest.approx([homogeneous] * 2)
    assert known.bending_torsion[2, 2] == pytest.approx(m.shear_ratio * 2 * homogeneous)
    printed = m.youngs_modulus_pa * (g.wall_second_moment_m4 + g.wall_area_m2 * 0.055**2 / 2)
    assert printed < 0.92 * homogeneous


def test_the_neutral_axis_is_where_eq_18_says() -> None:
    p = np.array([0.65, 0.3, 0.1]) * BAR
    e1, e2, e3 = frozen_stiffness_n(ARM, p, "secant")
    b, total = 0.055, e1 + e2 + e3
    printed = [math.sqrt(3) * b / 6 * (2 * e1 - e2 - e3) / total, b / 2 * (e2 - e3) / total, 0]
    assert NeutralSection.of(ARM, p, "secant").neutral_m == pytest.approx(printed, abs=1e-12)


def test_erratum_the_weights_moment_has_the_sign_of_eq_29() -> None:
    arm = replace(ARM, cap_mass_kg=0.3)
    p = np.array([0.65, 0.0, 0.0]) * BAR
    ours, _ = linear_rod_tip(arm, p, frozen_stiffness_n(arm, p, "tangent"))
    assert np.abs(PaperRod(arm, modulus_rule="tangent").statics(p).tip_m - ours).max() < 1e-8
    wrong = PaperRod(arm, modulus_rule="tangent", as_printed=frozenset({"weight moment"}))
    printed = wrong.statics(p).tip_m
    assert np.linalg.norm(printed - ours) > 0.002


def test_erratum_the_modulus_needs_the_inverse_slope_and_comes_out_at_290_kilopascals() -> None:
    # A_m / beta is m^2 / (1/N) = N m^2, no pressure. 1 / (A_m beta) is, and eq 32 fitted through the origin gives:
    m, area = Material.paper(), Geometry.paper().wall_area_m2
    force = np.arange(1, 13) * 0.1 * 9.81
    strain = m.a1_per_n * force + m.a2_per_n2 * force**2
    slope = (force @ strain) / (force @ force)
    assert 1 / (area * slope) == pytest.approx(290.5e3, rel=1e-3)
    assert 1 / (area * slope) == pytest.approx(m.youngs_modulus_pa, rel=0.006)
    assert area / slope < 1.0


def test_erratum_a_tangent_modulus_used_as_a_secant_bends_far_beyond_the_force_strain_curve() -> None:
    # The secant reproduces eq 32 for a tube pulled alone; the tangent, as printed in eq 33, overshoots it.
    m = Material.paper()
    n = 0.65 * BAR * Geometry.paper().chamber_area_m2
    measured = m.a1_per_n * n + m.a2_per_n2 * n * n
    p = np.array([0.65 * BAR] * 3)
    assert n / frozen_stiffness_n(ARM, p, "secant")[0] == pytest.approx(measured)
    assert n / frozen_stiffness_n(ARM, p, "tangent")[0] > 1.4 * measured
    one = (0.65 * BAR, 0, 0)
    tangent = abs(PaperRod(ARM, modulus_rule="tangent").statics(one).tip_m[0])
    rpe = abs(statics(Arm.paper("homogeneous+rpe"), one).tip_m[0])
    plain = abs(statics(Arm.paper("homogeneous"), one).tip_m[0])
    # Table 3: the inhomogeneity adds about a third of what the RPE does; the tangent adds over three times as much.
    assert abs(statics(ARM, one).tip_m[0]) - rpe < rpe - plain
    assert tangent - rpe > 3 * (rpe - plain)


def test_the_rule_for_passive_tubes_is_the_papers() -> None:
    p = np.array([0.65, 0.0, 0.0]) * BAR
    m, n = ARM.material, 0.65 * BAR * ARM.geometry.chamber_area_m2
    assert 1 / frozen_stiffness_n(ARM, p, "paper-secant") == pytest.approx(
        [m.a1_per_n + m.a2_per_n2 * n, *[m.a1_per_n + m.a2_per_n2 * n / 2] * 2]
    )
    assert 1 / frozen_stiffness_n(ARM, p, "secant") == pytest.approx(
        [m.a1_per_n + m.a2_per_n2 * n, m.a1_per_n, m.a1_per_n]
    )


def test_as_a_strain_the_radial_effect_stretches_each_tube_freely() -> None:
    arm = replace(Arm.paper("homogeneous+rpe"), gravity_m_s2=(0.0, 0.0, 0.0))
    plain = arm.with_segment(variant="homogeneous")
    p = np.array([0.6, 0.2, 0.0]) * BAR
    stretched = PaperRod(arm, rpe_as="strain").statics(p)
    grown = stretched.actuator_lengths_m - statics(plain, p).actuator_lengths_m
    assert grown == pytest.approx(0.17 * 0.05324473 * np.array([0.6, 0.2, 0.0]), rel=1e-3, abs=1e-6)


def test_an_unknown_way_of_the_radial_effect_is_refused() -> None:
    with pytest.raises(ValueError, match="force or strain"):
        PaperRod(Arm.paper("homogeneous+rpe"), rpe_as="stretch")  # type: ignore[arg-type]
