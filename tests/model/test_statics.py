"""The arm at rest: known tips, exact solutions, symmetry, and what happens when there is no solution."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, reject
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import expm

from model import Arm, Geometry, Loads, Material, NotConverged, Segment
from model.statics import statics
from tests.support.budget import examples

BAR = 1e5
pressure = st.floats(0.0, 0.65)
three_pressures = st.tuples(pressure, pressure, pressure)
variants = ("homogeneous", "homogeneous+rpe", "inhomogeneous+rpe")


def about_z(turn: float) -> NDArray[np.float64]:
    c, s = math.cos(turn), math.sin(turn)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("variant", "bar", "x_mm", "z_mm"),
    [
        ("homogeneous", (0.65, 0, 0), -50.75, 171.26),
        ("homogeneous+rpe", (0.65, 0, 0), -59.89, 169.26),
        ("homogeneous", (0, 0.65, 0.65), 53.70, 181.57),
        ("homogeneous+rpe", (0, 0.65, 0.65), 63.96, 181.19),
    ],
)
def test_tip_equals_an_independent_implementation(
    variant: str, bar: tuple[float, ...], x_mm: float, z_mm: float
) -> None:
    tip = statics(Arm.paper(variant), np.array(bar) * BAR).tip_m * 1e3
    assert tip == pytest.approx([x_mm, 0.0, z_mm], abs=0.0051)


@pytest.mark.parametrize("variant", variants)
@pytest.mark.parametrize("bar", [(0.65, 0.0, 0.0), (0.6, 0.35, 0.1)])
def test_without_weight_the_strain_is_the_same_everywhere(variant: str, bar: tuple[float, ...]) -> None:
    arm = replace(Arm.paper(variant), cap_mass_kg=0.0, gravity_m_s2=(0.0, 0.0, 0.0))
    shape = statics(arm, np.array(bar) * BAR)
    v, u = shape.v[0], shape.u[0]
    twist = np.zeros((4, 4))
    twist[:3, :3] = [[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]]
    twist[:3, 3] = v
    exact = expm(twist * arm.geometry.length_m)
    assert np.abs(shape.v - v).max() < 1e-9
    assert np.abs(shape.tip_m - exact[:3, 3]).max() < 1e-8
    assert np.abs(shape.tip_rotation - exact[:3, :3]).max() < 1e-7


def test_pressure_without_weight_bends_by_the_section_alone() -> None:
    # One tube pushes A_in P at x = b / sqrt 3: u2 = -M / K22, v3 - 1 = N / K33, no solver involved.
    g, m = Geometry.paper(), Material.paper()
    arm = replace(Arm.paper("homogeneous"), gravity_m_s2=(0.0, 0.0, 0.0))
    shape = statics(arm, (0.5 * BAR, 0, 0))
    push = 0.5 * BAR * g.chamber_area_m2
    bending = m.youngs_modulus_pa * (3 * g.wall_second_moment_m4 + g.wall_area_m2 * 0.055**2 / 2)
    assert shape.u[:, 1] == pytest.approx(-push * 0.055 / math.sqrt(3) / bending, rel=1e-9)
    assert shape.v[:, 2] - 1 == pytest.approx(push / (3 * m.youngs_modulus_pa * g.wall_area_m2), rel=1e-9)


@pytest.mark.parametrize("variant", variants)
def test_the_error_falls_with_the_fourth_power_of_the_step(variant: str) -> None:
    arm = replace(Arm.paper(variant), rod_weight=True)
    p = np.array([0.65, 0.1, 0.3]) * BAR
    fine = statics(arm, p, nodes=160).tip_m
    coarse, half = (np.abs(statics(arm, p, nodes=n).tip_m - fine).max() for n in (5, 10))
    assert coarse / half > 12
    assert np.abs(statics(arm, p).tip_m - fine).max() < 1e-8


@pytest.mark.parametrize("length_m", [0.05, 0.34, 0.7])
def test_the_default_steps_suffice_for_slender_arms_too(length_m: float) -> None:
    arm = Arm.paper()
    arm = arm.with_segment(geometry=replace(arm.geometry, length_m=length_m))
    p = np.array([0.5, 0.0, 0.1]) * BAR
    fine = statics(arm, p, nodes=320).tip_m
    assert np.abs(statics(arm, p).tip_m - fine).max() < 3e-8


@examples(25)
@given(three_pressures, st.floats(-math.pi, math.pi), st.sampled_from(variants))
def test_a_turned_arm_has_a_turned_tip(bar: tuple[float, ...], turn: float, variant: str) -> None:
    arm = Arm.paper(variant)
    turned_xy = (about_z(turn)[:2, :2] @ arm.geometry.positions_m.T).T
    turned = arm.with_segment(geometry=replace(arm.geometry, actuator_xy_m=tuple(map(tuple, turned_xy))))
    p = np.array(bar) * BAR
    assert np.abs(statics(turned, p).tip_m - about_z(turn) @ statics(arm, p).tip_m).max() < 1e-9


@examples(25)
@given(
    st.lists(st.tuples(st.floats(-0.04, 0.04), st.floats(-0.04, 0.04), pressure), min_size=1, max_size=7),
    st.floats(-math.pi, math.pi), st.floats(0.04, 0.4), st.sampled_from(variants),
    st.tuples(*[st.floats(-1, 1)] * 3), st.tuples(*[st.floats(-0.05, 0.05)] * 3),
)  # fmt: skip
def test_any_arm_and_its_loads_turned_have_a_turned_tip(
    tubes: list[tuple[float, float, float]], turn: float, length: float, variant: str, force: tuple[float, ...],
    point: tuple[float, ...],
) -> None:  # fmt: skip
    xy, p, q = np.array(tubes)[:, :2], np.array(tubes)[:, 2] * BAR, about_z(turn)
    tips = []
    for by in (np.eye(3), q):
        geometry = Geometry(length, 0.0095, 0.014, tuple(map(tuple, xy @ by[:2, :2].T)))
        arm = Arm((Segment(geometry, Material.paper(), variant),), rod_weight=True)
        loads = Loads(tip_force_n=by @ force, tip_point_m=by @ point, force_n_per_m=by @ (0.5, 0.0, 0.0))
        try:
            tips.append(statics(arm, p, loads, nodes=24).tip_m)
        except NotConverged:
            reject()
    assert np.abs(tips[1] - q @ tips[0]).max() < 1e-8


@examples(25)
@given(three_pressures, st.permutations([0, 1, 2]), st.sampled_from(variants))
def test_the_actuators_names_do_not_matter(bar: tuple[float, ...], order: list[int], variant: str) -> None:
    arm = Arm.paper(variant)
    xy = arm.geometry.actuator_xy_m
    renamed = arm.with_segment(geometry=replace(arm.geometry, actuator_xy_m=tuple(xy[k] for k in order)))
    p = np.array(bar) * BAR
    one, other = statics(arm, p), statics(renamed, p[order])
    assert np.abs(one.tip_m - other.tip_m).max() < 1e-10
    assert one.actuator_lengths_m[order] == pytest.approx(other.actuator_lengths_m, abs=1e-10)


@examples(25)
@given(three_pressures, st.sampled_from(variants))
def test_a_third_of_a_turn_is_a_change_of_names(bar: tuple[float, ...], variant: str) -> None:
    arm = Arm.paper(variant)
    p = np.array(bar) * BAR
    assert np.abs(about_z(2 * math.pi / 3) @ statics(arm, p).tip_m - statics(arm, np.roll(p, 1)).tip_m).max() < 1e-9


@pytest.mark.parametrize("variant", variants)
def test_without_load_and_pressure_the_arm_is_straight(variant: str) -> None:
    arm = replace(Arm.paper(variant), cap_mass_kg=0.0)
    shape = statics(arm, (0, 0, 0))
    straight = np.zeros_like(shape.p_m)
    straight[:, 2] = shape.s_m
    assert np.abs(shape.p_m - straight).max() < 1e-13
    assert np.abs(shape.rotation - np.eye(3)).max() < 1e-13
    assert shape.actuator_lengths_m == pytest.approx([0.17] * 3, abs=1e-13)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 6])
def test_any_number_of_actuators_is_one_geometry(count: int) -> None:
    angles = tuple(360.0 * k / count + 10 for k in range(count))
    geometry = Geometry.on_circle(0.17, 0.0095, 0.014, 0.0 if count == 1 else 0.03, angles)
    arm = replace(Arm.paper("homogeneous+rpe"), gravity_m_s2=(0.0, 0.0, 0.0)).with_segment(geometry=geometry)
    shape = statics(arm, [0.3 * BAR] * count)
    stretch = 0.3 * BAR * geometry.chamber_area_m2 / (289142.05 * geometry.wall_area_m2) + 0.05324473 * 0.3
    assert shape.tip_m == pytest.approx([0, 0, 0.17 * (1 + stretch)], abs=1e-10)


def in_pairs(arm: Arm) -> Arm:
    """The arm with every tube there twice, and twice the cap: then each tube carries what it carried."""
    xy = tuple(point for point in arm.geometry.actuator_xy_m for _ in range(2))
    return replace(arm, cap_mass_kg=2 * arm.cap_mass_kg).with_segment(geometry=replace(arm.geometry, actuator_xy_m=xy))


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_splitting_each_tube_in_two_changes_nothing_in_the_pointwise_section(count: int) -> None:
    angles = tuple(360.0 * k / count + 10 for k in range(count))
    arm = replace(Arm.paper(), rod_weight=True).with_segment(
        geometry=Geometry.on_circle(0.17, 0.0095, 0.014, 0.03, angles)
    )
    p = np.array([0.6, 0.1, 0.35, 0.2])[:count] * BAR
    one, twice = statics(arm, p), statics(in_pairs(arm), np.repeat(p, 2))
    assert np.abs(one.p_m - twice.p_m).max() < 1e-12
    assert np.abs(one.tip_m[:2]).max() > 1e-3


def test_actuators_may_stand_off_the_axis() -> None:
    # The same arm described from a line 20 mm aside: eq 29 relates the two axes.
    arm, shift = Arm.paper("homogeneous+rpe"), np.array([0.02, -0.01])
    xy = tuple(map(tuple, arm.geometry.positions_m + shift))
    aside = replace(arm, cap_mass_kg=0.0).with_segment(geometry=replace(arm.geometry, actuator_xy_m=xy))
    p = np.array([0.6, 0.2, 0.4]) * BAR
    one, other = statics(replace(arm, cap_mass_kg=0.0), p), statics(aside, p)
    offset = np.array([*shift, 0.0])
    assert np.abs(other.tip_m - (one.tip_m + offset - one.tip_rotation @ offset)).max() < 1e-9


def test_unequal_tubes_twist_nothing_and_couple_as_the_neutral_axis_says() -> None:
    # With frozen moduli the section about its stiffness-weighted centre must be free of coupling (eqs 18-21).
    from model.section import section

    g = Geometry.paper()
    stiffness = np.array([60.0, 110.0, 90.0])
    centre = (stiffness[:, None] * g.positions_m).sum(axis=0) / stiffness.sum()
    about = section(g, g.positions_m - centre, stiffness, 0.4, 0.05)
    assert np.abs(about.axial[0, 1:]).max() < 1e-12
    assert np.abs(about.shear[:2, 2]).max() < 1e-12


def test_the_pointwise_section_with_no_curvature_in_its_law_is_the_linear_one() -> None:
    g = Geometry.paper()
    material = replace(Material.paper(), a1_per_n=1 / (289142.05 * g.wall_area_m2), a2_per_n2=0.0)
    p = np.array([0.65, 0.0, 0.3]) * BAR
    pointwise = statics(Arm((Segment(g, material, "inhomogeneous+rpe"),)), p)
    linear = statics(Arm((Segment(g, material, "homogeneous+rpe"),)), p)
    assert np.abs(pointwise.p_m - linear.p_m).max() < 1e-11


def test_each_tube_follows_the_force_strain_curve_of_eq_32() -> None:
    # All three alike: no bending, so each wall carries A_in P and a third of the cap.
    arm = Arm.paper()
    m, n = arm.material, 0.5 * BAR * arm.geometry.chamber_area_m2 + 0.05 * 9.81 / 3
    strain = m.rpe_per_bar * 0.5 + m.a1_per_n * n + m.a2_per_n2 * n * n
    assert statics(arm, [0.5 * BAR] * 3).v[:, 2] == pytest.approx(1 + strain, rel=1e-9)
    # And oddly in compression: a vacuum that outweighs the cap.
    n = -0.2 * BAR * arm.geometry.chamber_area_m2 + 0.05 * 9.81 / 3
    strain = -m.rpe_per_bar * 0.2 + m.a1_per_n * n - m.a2_per_n2 * n * n
    assert statics(arm, [-0.2 * BAR] * 3).v[:, 2] == pytest.approx(1 + strain, rel=1e-9)


def test_a_small_side_load_bends_it_as_a_timoshenko_beam() -> None:
    arm = replace(Arm.paper("homogeneous"), gravity_m_s2=(0.0, 0.0, 0.0))
    g, m = arm.geometry, arm.material
    bending = m.youngs_modulus_pa * (3 * g.wall_second_moment_m4 + g.wall_area_m2 * 0.055**2 / 2)
    shear = 3 * m.shear_ratio * m.youngs_modulus_pa * g.wall_area_m2
    force = 1e-4
    tip = statics(arm, (0, 0, 0), Loads(tip_force_n=(0.0, force, 0.0))).tip_m
    assert tip[1] == pytest.approx(force * (0.17**3 / (3 * bending) + 0.17 / shear), rel=1e-6)
    spread = statics(arm, (0, 0, 0), Loads(force_n_per_m=(force, 0.0, 0.0))).tip_m
    assert spread[0] == pytest.approx(force * (0.17**4 / (8 * bending) + 0.17**2 / (2 * shear)), rel=1e-6)


def test_moments_at_the_tip_and_along_the_arm_bend_it_as_beam_theory_says() -> None:
    arm = replace(Arm.paper("homogeneous"), gravity_m_s2=(0.0, 0.0, 0.0))
    g, m = arm.geometry, arm.material
    bending = m.youngs_modulus_pa * (3 * g.wall_second_moment_m4 + g.wall_area_m2 * 0.055**2 / 2)
    shape = statics(arm, (0, 0, 0), Loads(tip_moment_n_m=(0.0, 0.2, 0.0)))
    radius = bending / 0.2
    angle = 0.17 / radius
    assert shape.tip_m == pytest.approx([radius * (1 - math.cos(angle)), 0, radius * math.sin(angle)], abs=1e-8)
    spread = statics(arm, (0, 0, 0), Loads(moment_n_m_per_m=(0.0, 1e-3, 0.0)))
    assert spread.tip_m[0] == pytest.approx(1e-3 * 0.17**3 / (3 * bending), rel=1e-6)


@examples(15)
@given(three_pressures, st.tuples(*[st.floats(-2, 2)] * 3), st.tuples(*[st.floats(-0.05, 0.05)] * 3))
def test_a_force_beside_the_axis_has_the_moment_of_its_lever_where_the_tip_has_turned_to(
    bar: tuple[float, ...], force: tuple[float, ...], point: tuple[float, ...]
) -> None:
    arm, p = Arm.paper(), np.array(bar) * BAR
    shape = statics(arm, p, Loads(tip_force_n=force, tip_point_m=point))
    moment = np.cross(shape.tip_rotation @ np.array(point), force)
    same = statics(arm, p, Loads(tip_force_n=force, tip_moment_n_m=moment))
    assert np.abs(shape.p_m - same.p_m).max() < 1e-9


def test_a_load_does_not_change_with_the_array_that_it_was_made_from() -> None:
    force = np.array([0.5, 0.0, 0.0])
    load = Loads(tip_force_n=force)
    force[:] = 0.0
    assert load.tip()[0] == 0.5


def test_its_own_weight_stretches_a_hanging_arm() -> None:
    arm = replace(Arm.paper("homogeneous"), rod_weight=True, cap_mass_kg=0.0)
    weight = arm.line_density_kg_m * 0.17 * 9.81
    stiffness = 3 * arm.material.youngs_modulus_pa * arm.geometry.wall_area_m2
    assert statics(arm, (0, 0, 0)).tip_m[2] == pytest.approx(0.17 * (1 + weight / (2 * stiffness)), rel=1e-10)


@examples(20)
@given(three_pressures, st.tuples(*[st.floats(-1, 1)] * 3), st.sampled_from(variants[:2]))
def test_the_base_carries_what_hangs_on_the_arm(bar: tuple[float, ...], force: tuple[float, ...], variant: str) -> None:
    # Global balance: total wrench at the base, from the solved strain there, against every load outside.
    from model.section import section

    arm = replace(Arm.paper(variant), rod_weight=True)
    p = np.array(bar) * BAR
    shape = statics(arm, p, Loads(tip_force_n=force), nodes=40)
    stiffness = np.full(3, arm.stiffness_n)
    law = section(arm.geometry, arm.geometry.positions_m, stiffness, arm.material.shear_ratio, arm.rpe_per_bar)
    strain = np.concatenate([shape.v[0], shape.u[0]])
    wrench = law.rest + law.per_pressure @ p
    for rows, block in (((2, 3, 4), law.axial), ((0, 1, 5), law.shear)):
        wrench[list(rows)] += block @ strain[list(rows)]
    tip_load = np.array([0, 0, 0.05 * 9.81]) + force
    own = np.array([0.0, 0.0, arm.line_density_kg_m * 9.81])
    along = np.trapezoid(np.cross(shape.p_m, own), shape.s_m, axis=0)
    assert wrench[:3] == pytest.approx(tip_load + own * 0.17, abs=1e-8)
    assert wrench[3:] == pytest.approx(np.cross(shape.tip_m, tip_load) + along, abs=1e-4)


@examples(30)
@given(st.tuples(*[st.floats(-1e3, 1e3)] * 3), st.tuples(*[st.floats(-1e3, 1e3)] * 3), st.sampled_from(variants))
def test_any_pressure_and_load_give_a_finite_shape_or_an_error(
    bar: tuple[float, ...], force: tuple[float, ...], variant: str
) -> None:
    try:
        shape = statics(Arm.paper(variant), np.array(bar) * BAR, Loads(tip_force_n=force), doubt_units=False)
    except NotConverged:
        return
    assert np.isfinite(shape.p_m).all()
    assert np.isfinite(shape.rotation).all()


def test_the_error_names_the_pressures_that_have_no_equilibrium() -> None:
    with pytest.raises(NotConverged, match=r"1e\+06, 0, 0 bar"):
        statics(Arm.paper("homogeneous"), (1e6 * BAR, 0, 0), doubt_units=False)


def test_a_vertical_load_beyond_buckling_gives_the_straight_solution_or_an_error() -> None:
    up = replace(Arm.paper("homogeneous"), cap_mass_kg=1.0, gravity_m_s2=(0.0, 0.0, -9.81))
    assert np.isfinite(statics(up, (0, 0, 0)).p_m).all()
