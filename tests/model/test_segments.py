"""Arms of several segments: closed forms, the same arm cut into pieces, and bodies that are nearly rigid."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import simpson
from scipy.linalg import expm

from model import (
    Arm,
    Coupling,
    Geometry,
    Loads,
    Material,
    Segment,
    SeveralSegments,
    Shape,
    Unstable,
    batch,
    sensitivities,
)
from model.actuation import PressureSum, StopElement
from model.arrays import Array
from model.dynamics import Dynamics
from model.material import MaxwellBranch
from model.section import section
from model.statics import statics
from model.variants import ModelVariant, register
from model.variation import TipWrench, Variation
from tests.support.neo_hookean import NeoHookean

BAR = 1e5
NOTHING = (0.0, 0.0, 0.0)
VARIANTS = ("homogeneous+rpe", "inhomogeneous+rpe")
THIN = Geometry.on_circle(0.12, 0.007, 0.0105, 0.02, (30.0, 150.0, 270.0, 0.0))
ASIDE = Geometry(0.09, 0.006, 0.009, ((0.02, 0.0), (-0.01, 0.012)))
PRESSURES = np.array([0.4, 0.1, 0.0, 0.3, 0.0, 0.2, 0.1, 0.15, 0.05]) * BAR


def softer(material: Material) -> Material:
    return replace(material, youngs_modulus_pa=0.7 * material.youngs_modulus_pa, a1_per_n=1.3 * material.a1_per_n)


def three(variant: str, **changes: object) -> Arm:
    """Three segments: three, four and two tubes, with other radii, materials and a centroid beside the axis."""
    material = Material.paper()
    segments = (
        Segment(Geometry.paper(), material, variant),
        Segment(THIN, softer(material), variant, Coupling(0.02, 0.03)),
        Segment(ASIDE, material, "homogeneous", Coupling(0.01, 0.01)),
    )
    return Arm(segments, **changes)  # type: ignore[arg-type]


def cut(arm: Arm) -> Arm:
    """The arm of one segment in two pieces of unequal length, each with chambers of its own."""
    first, second = (replace(arm.geometry, length_m=share * arm.geometry.length_m) for share in (0.4, 0.6))
    return replace(arm, segments=[replace(arm.only_segment, geometry=piece) for piece in (first, second)])


def generator(strain: Array) -> Array:
    """The strain (v, u) as an element (4, 4) of se(3)."""
    (v1, v2, v3), (u1, u2, u3) = strain[:3], strain[3:]
    return np.array([[0, -u3, u2, v1], [u3, 0, -u1, v2], [-u2, u1, 0, v3], [0, 0, 0, 0]])


def product_of_exponentials(arm: Arm, shape: Shape) -> Array:
    pose = np.eye(4)
    for segment, start in zip(arm.segments, shape.first_nodes, strict=False):
        pose = pose @ expm(segment.coupling.length_m * generator(np.array([0, 0, 1.0, 0, 0, 0])))
        strain = np.concatenate([shape.v[start], shape.u[start]])
        pose = pose @ expm(segment.geometry.length_m * generator(strain))
    return pose


@pytest.mark.parametrize("variant", VARIANTS)
def test_without_weight_the_tip_is_the_product_of_the_exponentials_of_the_segments(variant: str) -> None:
    arm = three(variant, gravity_m_s2=NOTHING)
    shape = statics(arm, PRESSURES)
    pose = product_of_exponentials(arm, shape)
    assert np.linalg.norm(shape.tip_m - [0, 0, arm.length_m]) > 0.05
    assert np.abs(shape.tip_m - pose[:3, 3]).max() < 1e-8
    assert np.abs(shape.tip_rotation - pose[:3, :3]).max() < 1e-7


@pytest.mark.parametrize("variant", VARIANTS)
def test_the_strain_of_each_segment_is_that_of_an_arm_of_this_segment_alone(variant: str) -> None:
    arm = three(variant, gravity_m_s2=NOTHING)
    shape = statics(arm, PRESSURES)
    first = 0
    for segment, start in zip(arm.segments, shape.first_nodes, strict=False):
        count = segment.geometry.actuators
        alone = Arm((replace(segment, coupling=Coupling()),), gravity_m_s2=NOTHING)
        own = statics(alone, PRESSURES[first : first + count])
        assert shape.v[start] == pytest.approx(own.v[0], abs=1e-10)
        assert shape.u[start] == pytest.approx(own.u[0], abs=1e-8)
        assert shape.actuator_lengths_m[first : first + count] == pytest.approx(own.actuator_lengths_m, abs=1e-9)
        first += count


def test_a_chamber_acts_on_its_own_segment_only() -> None:
    arm = three("homogeneous+rpe", gravity_m_s2=NOTHING)
    pressure = np.zeros(9)
    pressure[3] = 0.4 * BAR
    shape = statics(arm, pressure)
    _, second, third, end = shape.first_nodes
    assert np.abs(shape.u[:second]).max() < 1e-9
    assert np.abs(shape.u[second:third]).max() > 0.5
    assert np.abs(shape.u[third:end]).max() < 1e-9


@pytest.mark.parametrize("variant", VARIANTS)
def test_an_arm_cut_in_two_rests_where_it_did(variant: str) -> None:
    arm = replace(Arm.paper(variant), rod_weight=True)
    pressure = np.array([0.4, 0.1, 0.0]) * BAR
    loads = Loads((0.1, 0.2, -0.1), (0.003, 0.0, 0.001), [NOTHING, (0.5, 0.0, 0.0)], tip_point_m=(0.01, 0.0, 0.02))
    whole, parts = statics(arm, pressure, loads, 60), statics(cut(arm), np.tile(pressure, 2), loads, 61)
    assert np.abs(whole.tip_m - parts.tip_m).max() < 1e-10
    assert np.abs(whole.tip_rotation - parts.tip_rotation).max() < 1e-9
    at = np.array([0.03, 0.068, 0.11, 0.17])
    for one, other in zip(whole.frames_at(at), parts.frames_at(at), strict=True):
        assert np.abs(one - other).max() < 1e-5


@pytest.mark.parametrize("dt_s", [1 / 30, 0.004])
@pytest.mark.parametrize("variant", VARIANTS)
def test_an_arm_cut_in_two_moves_as_it_did(variant: str, dt_s: float) -> None:
    material = replace(Material.paper(), damping_s=0.005, branches=(MaxwellBranch(0.1, 0.5),))
    arm = Arm(
        (Segment(Geometry.paper(), material, variant),), rod_weight=True, cap_inertia=True,
        cap_inertia_kg_m2=(1e-5, 1e-5, 2e-5), actuation=PressureSum(0.1, (StopElement(0.1, 2e4),)),
    )  # fmt: skip
    rows = np.array([0.4, 0.1, 0.0]) * BAR * (0.6 + 0.4 * np.sin(0.8 * np.arange(12)))[:, None]
    whole, parts = Dynamics(arm, dt_s, nodes=40), Dynamics(cut(arm), dt_s, nodes=41)
    whole.start(rows[0])
    parts.start(np.tile(rows[0], 2))
    one, other = whole.run(rows[1:]), parts.run(np.tile(rows[1:], 2))
    assert one.ok.all()
    assert other.ok.all()
    assert np.ptp(one.tip_m, axis=0).max() > 2e-3
    assert np.abs(one.tip_m - other.tip_m).max() < 1e-7


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_long_coupling_moves_as_a_segment_that_is_nearly_rigid(variant: str) -> None:
    material = Material.paper()
    stiff = replace(material, youngs_modulus_pa=3e4 * material.youngs_modulus_pa, density_kg_m3=1.0, rpe_per_bar=0.0)
    rigid = Segment(replace(Geometry.paper(), length_m=0.03), stiff, "homogeneous")
    last = Segment(THIN, material, variant)
    first = Segment(Geometry.paper(), material, variant)
    coupled, built = Arm((first, replace(last, coupling=Coupling(0.03)))), Arm((first, rigid, last))
    pressure = PRESSURES[:7]
    loads = Loads(tip_force_n=(0.2, -0.1, 0.1))
    among = np.insert(pressure, 3, np.zeros(3))
    assert np.abs(statics(coupled, pressure, loads).tip_m - statics(built, among, loads, 60).tip_m).max() < 2e-5
    one, other = Dynamics(coupled, 0.02, nodes=60), Dynamics(built, 0.02, nodes=60)
    one.start(pressure, loads)
    other.start(among, loads)
    for k in range(6):
        first, second = one.step(pressure * (k % 2), loads), other.step(among * (k % 2), loads)
        assert first.ok
        assert np.abs(first.tip_m - second.tip_m).max() < 1e-4


def test_the_weight_of_a_coupling_hangs_on_the_segments_before() -> None:
    material = Material.paper()
    half = replace(Geometry.paper(), length_m=0.085)
    segment = Segment(half, material, "homogeneous")
    arm = Arm((segment, replace(segment, coupling=Coupling(0.01, 0.2))))
    stiffness = 3 * material.youngs_modulus_pa * half.wall_area_m2
    expected = 0.01 + 0.085 * (2 + (0.25 + 0.05) * 9.81 / stiffness)
    assert statics(arm, np.zeros(6)).tip_m == pytest.approx([0, 0, expected], abs=1e-10)


def test_a_coupling_swings_on_its_segment_as_a_cap_of_the_same_mass() -> None:
    # The second segment is short and light; an eighth of a per cent of the swing is its own.
    material = replace(Material.paper(), density_kg_m3=1.0)
    short = replace(Geometry.paper(), length_m=1e-3)
    first = Segment(Geometry.paper(), material, "homogeneous")
    capped = Arm((first,), cap_mass_kg=0.1, cap_inertia=True)
    coupled = Arm((first, Segment(short, material, "homogeneous", Coupling(0.0, 0.1))), 0.0, cap_inertia=True)
    one, other = Dynamics(capped, 0.01, nodes=24), Dynamics(coupled, 0.01, nodes=27)
    one.start(NOTHING, Loads(tip_force_n=(0.5, 0.0, 0.0)))
    other.start(np.zeros(6), Loads(tip_force_n=(0.5, 0.0, 0.0)))
    still = Loads()
    for _ in range(30):
        first, second = one.step(NOTHING, still).tip_m, other.step(np.zeros(6), still)
        assert second.ok
        joint = second.p_m[second.first_nodes[1] - 1]
        assert first == pytest.approx(joint, abs=4e-4)


def test_a_stepped_cantilever_bends_as_timoshenko_beams_in_series() -> None:
    even = replace(THIN, actuator_xy_m=((0.02, 0.0), (-0.02, 0.0), (0.0, 0.02), (0.0, -0.02)))
    second = Segment(even, softer(Material.paper()), "homogeneous")
    first = Segment(Geometry.paper(), Material.paper(), "homogeneous")
    arm = Arm((first, second), gravity_m_s2=NOTHING, cap_mass_kg=0.0)
    force, place, turn, lever = 1e-3, 0.0, 0.0, arm.length_m
    for segment in arm.segments:
        geometry, modulus, length = segment.geometry, segment.material.youngs_modulus_pa, segment.geometry.length_m
        xy = geometry.positions_m - geometry.centroid_m
        bending = modulus * (geometry.wall_area_m2 * xy[:, 0] ** 2 + geometry.wall_second_moment_m4).sum()
        shear = segment.material.shear_ratio * segment.stiffness_n * geometry.actuators
        beyond = lever - length
        moment = force * beyond
        place += turn * length + force * length**3 / (3 * bending) + moment * length**2 / (2 * bending)
        place += force * length / shear
        turn += force * length**2 / (2 * bending) + moment * length / bending
        lever = beyond
    tip = statics(arm, np.zeros(7), Loads(tip_force_n=(force, 0.0, 0.0))).tip_m
    assert tip[0] == pytest.approx(place, rel=1e-5)


def energy(arm: Arm, dynamics: Dynamics) -> float:
    """Kinetic plus elastic energy of linear segments without pressure, from the solver's own states."""
    total = 0.0
    x, first = dynamics.state.x, dynamics.arm_with_cap.line[0]
    for segment, begin, end in zip(arm.segments, first, first[1:], strict=False):
        g, rows = segment.geometry, x[begin:end]
        stiffness = np.full(g.actuators, segment.stiffness_n)
        xy = g.positions_m - g.centroid_m
        law = section(g, xy, stiffness, segment.material.shear_ratio, 0.0)
        strain = rows[:, :6] - np.array([0, 0, 1.0, 0, 0, 0])
        axial, shear = strain[:, [2, 3, 4]], strain[:, [0, 1, 5]]
        elastic = np.einsum("ni,ij,nj->n", axial, law.axial, axial) + np.einsum("ni,ij,nj->n", shear, law.shear, shear)
        area, own, density = g.wall_area_m2, g.wall_second_moment_m4, segment.material.density_kg_m3
        xx, yy, cross = (area * xy[:, 0] ** 2 + own).sum(), (area * xy[:, 1] ** 2 + own).sum(), area * xy.prod(1).sum()
        inertia = density * np.array([[yy, -cross, 0], [-cross, xx, 0], [0, 0, xx + yy]])
        turning = np.einsum("ni,ij,nj->n", rows[:, 9:12], inertia, rows[:, 9:12])
        kinetic = segment.line_density_kg_m * (rows[:, 6:9] ** 2).sum(1) + turning
        total += float(simpson(0.5 * (elastic + kinetic), dx=g.length_m / (end - begin - 1)))
    return total


def test_the_trapezoidal_rule_keeps_the_energy_of_segments() -> None:
    arm = three("homogeneous", gravity_m_s2=NOTHING, cap_mass_kg=0.0)
    first, *others = arm.segments
    arm = replace(arm, segments=[first, *(replace(segment, coupling=Coupling(0.01)) for segment in others)])
    dynamics = Dynamics(arm, 0.001, "trapezoidal")
    dynamics.start(np.zeros(9), Loads(tip_force_n=(0.1, 0.06, 0.0)))
    first, still = energy(arm, dynamics), Loads()
    for _ in range(200):
        assert dynamics.step(np.zeros(9), still).ok
    assert energy(arm, dynamics) == pytest.approx(first, rel=0.01)


# The third segment is so soft that one-sided differences of 1e-7 leave up to a thousandth.
SOFT = 2e-3


def every_change(x: float) -> tuple[Arm, Array]:
    """An arm of three segments and its pressures, along a line through everything that an identification changes."""
    arm = three(
        "inhomogeneous+rpe", rod_weight=True, gravity_m_s2=(2.0 + 3 * x, -2 * x, 9.0), cap_mass_kg=0.05 + 0.1 * x
    )
    first, second, third = arm.segments
    material = replace(second.material, a1_per_n=second.material.a1_per_n * (1 + x), shear_ratio=0.41 * (1 - x))
    geometry = replace(second.geometry, length_m=0.12 * (1 + x), inner_radius_m=0.007 * (1 + 0.2 * x))
    aside = replace(ASIDE, actuator_xy_m=((0.02 * (1 + x), 0.002 * x), (-0.01, 0.012)))
    segments = (
        replace(first, geometry=replace(first.geometry, length_m=0.17 * (1 - 0.5 * x))),
        replace(second, material=material, geometry=geometry, coupling=Coupling(0.02 * (1 + x), 0.03 * (1 + x))),
        replace(third, geometry=aside),
    )
    return replace(arm, segments=segments), PRESSURES * (1 + 0.5 * x)


def slope(at: object, h: float = 2e-3) -> Array:
    one, two, four = ((at(k * h) - at(-k * h)) / (2 * k * h) for k in (1, 2, 4))  # type: ignore[operator]
    return (64 * one - 20 * two + four) / 45


def test_gradients_at_rest_equal_finite_differences() -> None:
    sections = np.array([0.1, 0.25, 0.37])
    weight = [0.02]

    def poses(x: float) -> Array:
        arm, pressure = every_change(x)
        found = sensitivities.statics(arm, pressure[None], (), weight, sections_m=sections, nodes=60)
        return np.concatenate([found.tip_m[0], found.section_m[0].ravel()])

    arm, pressure = every_change(0.0)
    changed, pressed = every_change(1e-7)
    change = Variation(1e-7, changed, pressed[None])
    found = sensitivities.statics(arm, pressure[None], [change], weight, sections_m=sections, nodes=60)
    by = np.concatenate([found.tip_by[0, :, 0], found.section_by[0, :, :, 0].ravel()])
    assert by == pytest.approx(slope(poses), rel=SOFT, abs=5e-6)


def test_gradients_in_motion_equal_finite_differences(monkeypatch: pytest.MonkeyPatch) -> None:
    # What Newton's method leaves of a step differs from one neighbour to the next: here it leaves nothing.
    monkeypatch.setattr("model.dynamics.TOLERANCE_IN_MOTION", 1e-7)
    monkeypatch.setattr("model.sensitivities.TOLERANCE_IN_MOTION", 1e-7)
    course = np.array([1.0, 1.2, 0.8, 0.9, 1.1])[:, None]
    pull = TipWrench(np.full((5, 3), 0.1), np.full((5, 3), 0.001), np.array([0.01, 0.0, 0.02]))

    def viscous(x: float) -> tuple[Arm, Array]:
        arm, pressure = every_change(x)
        branches = (MaxwellBranch(0.1, 1 + x),)
        material = replace(arm.segments[1].material, damping_s=0.01 * (1 + x), branches=branches)
        return arm.with_segment(1, material=material), pressure * course

    def tips(x: float) -> Array:
        arm, rows = viscous(x)
        dynamics = Dynamics(arm, 0.05, nodes=40)
        loads = Loads((0.1,) * 3, (0.001,) * 3, tip_point_m=(0.01, 0.0, 0.02))
        first = dynamics.start(rows[0], loads)
        return np.array([first.tip_m, *(dynamics.step(row, loads).tip_m for row in rows[1:])])

    (arm, rows), (changed, pressed) = viscous(0.0), viscous(1e-7)
    found = sensitivities.motion(arm, rows, 0.05, [Variation(1e-7, changed, pressed)], nodes=40, tip_wrench=pull)
    assert found.tip_m == pytest.approx(tips(0.0), abs=1e-9)
    assert found.tip_by[:, :, 0] == pytest.approx(slope(tips), rel=SOFT, abs=5e-6)


def test_the_gradient_of_the_tip_names_the_parameters_by_segment() -> None:
    arm = three("homogeneous+rpe")
    found = sensitivities.tip_gradient(arm, PRESSURES)
    material, step = arm.segments[1].material, 100.0
    changed = [
        arm.with_segment(1, material=replace(material, youngs_modulus_pa=material.youngs_modulus_pa + h))
        for h in (step, -step)
    ]
    by = (statics(changed[0], PRESSURES).tip_m - statics(changed[1], PRESSURES).tip_m) / (2 * step)
    assert found.by_parameter["segment_2.youngs_modulus_pa"] == pytest.approx(by, rel=SOFT, abs=1e-12)
    assert "segment_3.youngs_modulus_pa" in found.by_parameter
    assert found.by_pressure.shape == (3, 9)


def test_a_batch_equals_its_members() -> None:
    arms = [three("inhomogeneous+rpe", cap_mass_kg=mass) for mass in (0.02, 0.1)]
    rows = np.stack([PRESSURES, PRESSURES[::-1]])
    tips = batch.statics(arms, rows)
    assert tips.ok.all()
    for arm, row, tip in zip(arms, rows, tips.tip_m, strict=True):
        assert np.array_equal(tip, statics(arm, row).tip_m)


def stepped_column(coupling_m: float) -> Arm:
    """Two slender tubes in series, without shear, that carry nothing but a force at the tip."""
    material = replace(Material.paper(), youngs_modulus_pa=1e8, shear_ratio=1e3)
    one, two = (Geometry(length, 1e-5, radius, ((0.0, 0.0),)) for length, radius in ((0.3, 0.01), (0.2, 0.007)))
    segments = Segment(one, material, "homogeneous"), Segment(two, material, "homogeneous", Coupling(coupling_m))
    return Arm(segments, cap_mass_kg=0.0, gravity_m_s2=NOTHING)


@pytest.mark.parametrize("coupling_m", [0.0, 0.1])
def test_a_stepped_column_buckles_at_its_critical_load(coupling_m: float) -> None:
    arm = stepped_column(coupling_m)
    (b1, b2), (l1, l2) = (
        [s.material.youngs_modulus_pa * s.geometry.wall_second_moment_m4 for s in arm.segments],
        [s.geometry.length_m for s in arm.segments],
    )

    def determinant(force: float) -> float:
        # B w'' = P (w_tip - w): the distance y = w_tip - w and its slope, from the base over the link to the tip.
        k1, k2 = math.sqrt(force / b1), math.sqrt(force / b2)
        slope = -k1 * math.sin(k1 * l1)
        y = math.cos(k1 * l1) + slope * coupling_m
        return -(y * math.cos(k2 * l2) + slope / k2 * math.sin(k2 * l2))

    low, high = 1e-3, 10.0
    while determinant(high) < 0:
        high *= 1.5
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if determinant(middle) < 0 else (low, middle)
    safe, beyond = (Loads(tip_force_n=(0.0, 0.0, -share * low)) for share in (0.98, 1.02))
    assert statics(arm, np.zeros(2), safe).stable
    with pytest.raises(Unstable):
        statics(arm, np.zeros(2), beyond)


def test_two_laws_of_the_tubes_in_one_arm_are_refused() -> None:
    register(ModelVariant("neo-hookean-segment", NeoHookean(), radial_effect=False))
    other = Segment(THIN, Material.paper(), "neo-hookean-segment")
    with pytest.raises(ValueError, match="one law of the tubes"):
        Arm((*Arm.paper().segments, other))


def test_a_coupling_before_the_first_segment_is_refused() -> None:
    with pytest.raises(ValueError, match="the first segment of an arm is clamped"):
        Arm((Segment(THIN, Material.paper(), coupling=Coupling(0.01)),))


def test_an_arm_of_several_segments_has_no_one_geometry() -> None:
    with pytest.raises(SeveralSegments, match="3 segments"):
        three("homogeneous").geometry  # noqa: B018 - the property raises


def test_too_few_steps_for_the_segments_are_refused() -> None:
    with pytest.raises(ValueError, match="needs at least 8 steps"):
        statics(three("homogeneous"), PRESSURES, nodes=6)


@pytest.mark.parametrize("wrong", [{"length_m": -0.1}, {"mass_kg": math.inf}])
def test_an_impossible_coupling_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Coupling(**wrong)


def test_pressures_of_the_first_segment_alone_are_refused() -> None:
    with pytest.raises(ValueError, match="must hold 9 numbers"):
        statics(three("homogeneous"), np.zeros(3))


def test_a_coupling_is_straight_between_its_ends() -> None:
    shape = statics(three("inhomogeneous+rpe"), PRESSURES)
    end, begin = shape.first_nodes[1] - 1, shape.first_nodes[1]
    places, turns = shape.frames_at(shape.s_m[end] + np.array([0.0, 0.005, 0.02]))
    along = shape.p_m[begin] - shape.p_m[end]
    assert np.linalg.norm(along) == pytest.approx(0.02, abs=1e-9)
    assert places == pytest.approx(shape.p_m[end] + np.outer([0, 0.25, 1], along), abs=1e-12)
    assert turns == pytest.approx(np.repeat(shape.rotation[end][None], 3, axis=0), abs=1e-12)
