"""Maxwell branches of the walls: relaxation and creep against closed forms, order, dissipation, gradients, rest."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from model import Arm, Loads, sensitivities
from model.arrays import Array
from model.dynamics import Dynamics
from model.material import MaxwellBranch
from model.paper.rod import PaperRod
from model.statics import statics
from model.variation import Variation

BAR = 1e5
BRANCHES = (MaxwellBranch(0.2, 0.7), MaxwellBranch(0.1, 9.0))


def viscous(branches: tuple[MaxwellBranch, ...] = BRANCHES, variant: str = "homogeneous", **changed) -> Arm:  # type: ignore[no-untyped-def]
    arm = Arm.paper(variant)
    material = replace(arm.material, branches=branches)
    return replace(arm, **{"cap_mass_kg": 0.0, "inertia": False, **changed}).with_segment(material=material)


def stretch_per_pa(arm: Arm) -> float:
    """Elongation at rest per pascal in every chamber of a homogeneous arm without cap."""
    geometry = arm.geometry
    return geometry.chamber_area_m2 / (arm.material.youngs_modulus_pa * geometry.wall_area_m2)


def elongations(arm: Arm, pressure_pa: Array, dt_s: float) -> Array:
    """Stretch of the arm, from rest under the first of equal pressures (T,) in all chambers."""
    dynamics = Dynamics(arm, dt_s)
    dynamics.start(np.full(3, pressure_pa[0]))
    moved = dynamics.run(np.tile(pressure_pa[1:, None], 3))
    assert moved.ok.all()
    return moved.tip_m[:, 2] / arm.geometry.length_m - 1


@pytest.mark.parametrize("dt_s", [0.05, 0.5, 2.0])
def test_linear_strain_histories_relax_exactly_at_any_step(dt_s: float) -> None:
    # Stretched evenly for 4 s, then held: the pressure that this takes, by the Prony series.
    arm, rate, until = viscous(), 0.02, 4.0
    t = np.arange(0.0, 12.0 + dt_s / 2, dt_s)
    strain = rate * np.minimum(t, until)
    stress = strain.copy()
    for branch in BRANCHES:
        grown = rate * branch.time_s * -np.expm1(-np.minimum(t, until) / branch.time_s)
        stress += branch.relative_modulus * grown * np.exp(-np.maximum(t - until, 0) / branch.time_s)
    assert elongations(arm, stress / stretch_per_pa(arm), dt_s) == pytest.approx(strain[1:], abs=1e-9)


def test_steps_of_any_length_relax_exactly() -> None:
    arm = viscous()
    dynamics, time_s, rng = Dynamics(arm, 0.1), 0.0, np.random.default_rng(4)
    dynamics.start((0, 0, 0))
    for dt_s in rng.uniform(0.01, 1.5, 25):
        time_s += float(dt_s)
        held = [b.relative_modulus * b.time_s * -math.expm1(-time_s / b.time_s) for b in BRANCHES]
        pressure = 0.01 * (time_s + sum(held)) / stretch_per_pa(arm)
        shape = dynamics.step(np.full(3, pressure), dt_s=float(dt_s))
        assert shape.tip_m[2] / arm.geometry.length_m - 1 == pytest.approx(0.01 * time_s, abs=1e-8)


def test_creep_under_a_ramp_converges_with_the_square_of_the_step() -> None:
    # Creep compliance of a standard linear solid, 1 - g / (1 + g) exp(-t / (T (1 + g))), integrated over the ramp.
    g, relaxation_s = 0.3, 0.8
    arm, retardation_s = viscous((MaxwellBranch(g, relaxation_s),)), 0.8 * 1.3
    rate, end_s, errors = 0.1 * BAR, 2.0, []
    closed = end_s - g * relaxation_s * -math.expm1(-end_s / retardation_s)
    for steps in (8, 16, 32):
        ramp = rate * np.linspace(0, end_s, steps + 1)
        errors.append(elongations(arm, ramp, end_s / steps)[-1] / (stretch_per_pa(arm) * rate) - closed)
    assert abs(errors[-1]) < 1e-4
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx(2.0, abs=0.1)


def test_a_sudden_weight_creeps_as_a_sudden_pressure_does() -> None:
    g, relaxation_s, dt_s = 0.25, 1.0, 0.005
    arm = viscous((MaxwellBranch(g, relaxation_s),))
    dynamics, pull = Dynamics(arm, dt_s), Loads(tip_force_n=(0.0, 0.0, 1.0))
    dynamics.start((0, 0, 0))
    stretch = np.array([dynamics.step((0, 0, 0), pull).tip_m[2] for _ in range(400)]) / arm.geometry.length_m - 1
    stiffness = 3 * arm.material.youngs_modulus_pa * arm.geometry.wall_area_m2
    t = dt_s * np.arange(400) + dt_s / 2  # the load comes on within the first step
    closed = (1 - g / (1 + g) * np.exp(-t / (relaxation_s * (1 + g)))) / stiffness
    assert stretch[1:] == pytest.approx(closed[1:], rel=1e-4)


@pytest.mark.parametrize("period_s", [0.5, 5.0, 50.0])
def test_a_cycle_loses_what_the_loss_compliance_says(period_s: float) -> None:
    arm, parts, amplitude = viscous(), 400, 0.1 * BAR
    dt_s, omega = period_s / parts, 2 * math.pi / period_s
    cycles = max(2, math.ceil(40.0 / period_s))
    pressure = amplitude * np.sin(omega * dt_s * np.arange(cycles * parts + 1))
    stretch = elongations(arm, pressure, dt_s)
    last, below = pressure[-parts:], pressure[-parts - 1 : -1]
    lost = float((0.5 * (last + below) * np.diff(stretch[-parts - 1 :])).sum())
    modulus = 1 + sum(b.relative_modulus * 1j * omega * b.time_s / (1 + 1j * omega * b.time_s) for b in BRANCHES)
    assert lost == pytest.approx(-math.pi * amplitude**2 * stretch_per_pa(arm) * (1 / modulus).imag, rel=2e-3)


@pytest.mark.parametrize("variant", ["homogeneous", "inhomogeneous+rpe"])
def test_no_course_of_pressures_gains_energy(variant: str) -> None:
    arm, rng = viscous(variant=variant), np.random.default_rng(7)
    for _ in range(3):
        corners = np.concatenate([[0], rng.uniform(0, 0.4, 6), [0, 0]]) * BAR
        pressure = np.interp(np.linspace(0, 8, 481), np.arange(9), corners)
        stretch = np.concatenate([[0], elongations(arm, pressure, 0.05)])
        if variant != "homogeneous":
            # Free strain: the pressure does no work on the wall by it.
            stretch -= arm.material.rpe_per_bar * pressure / BAR
        assert (0.5 * (pressure[1:] + pressure[:-1]) * np.diff(stretch)).sum() > 0


@pytest.mark.parametrize("variant", ["homogeneous+rpe", "inhomogeneous+rpe"])
def test_branches_change_no_equilibrium(variant: str) -> None:
    bent = np.array([0.5, 0.1, 0.0]) * BAR
    for inertia in (True, False):
        arm = viscous(variant=variant, inertia=inertia, cap_mass_kg=0.05)
        elastic = arm.with_segment(material=replace(arm.material, branches=()))
        assert np.array_equal(statics(arm, bent).tip_m, statics(elastic, bent).tip_m)
        dynamics = Dynamics(arm, 0.02)
        dynamics.start(bent)
        assert np.abs(dynamics.run([bent] * 3).tip_m - statics(elastic, bent, nodes=80).tip_m).max() < 1e-7


def test_an_arm_without_inertia_and_memory_is_always_in_equilibrium() -> None:
    arm = replace(Arm.paper(), inertia=False)
    dynamics = Dynamics(arm, 0.001)
    dynamics.start((0, 0, 0))
    for pressure in ([0.3 * BAR, 0, 0], [0.5 * BAR, 0.2 * BAR, 0], [0, 0, 0.4 * BAR]):
        for _ in range(2):  # what is left of Newton's method after one step the next one corrects
            shape = dynamics.step(pressure)
        assert np.abs(shape.tip_m - statics(arm, pressure).tip_m).max() < 1e-7


def test_relaxation_slows_the_swing_down_and_ends_at_the_same_place() -> None:
    arm = viscous((MaxwellBranch(0.3, 0.05),), inertia=True, cap_mass_kg=0.05)
    dynamics = Dynamics(arm, 0.005, "trapezoidal")
    dynamics.start((0, 0, 0))
    moved = dynamics.run([(0.3 * BAR, 0, 0)] * 1600)
    rest = statics(arm, (0.3 * BAR, 0, 0)).tip_m
    distance = np.linalg.norm(moved.tip_m - rest, axis=1)
    assert distance[-1] < 0.02 * distance[:200].max()


@pytest.mark.parametrize("inertia", [True, False])
@pytest.mark.parametrize("variant", ["homogeneous", "inhomogeneous+rpe"])
def test_gradients_are_those_of_finite_differences(variant: str, inertia: bool) -> None:
    t = np.arange(40) * 0.05
    rows = BAR * np.stack([0.3 * np.sin(t) ** 2, 0.2 * np.minimum(t, 1.0), 0.1 * np.cos(t) ** 2], axis=1)

    def arm_at(modulus: float = 0.2, time_s: float = 0.7, damping_s: float = 0.02) -> Arm:
        arm = viscous((MaxwellBranch(modulus, time_s), BRANCHES[1]), variant, inertia=inertia, cap_mass_kg=0.05)
        return arm.with_segment(material=replace(arm.material, damping_s=damping_s))

    varied = ({"modulus": 0.2}, {"time_s": 0.7}, {"damping_s": 0.02})
    changes = [Variation(1e-7, arm_at(**{name: value + 1e-7})) for one in varied for name, value in one.items()]
    found = sensitivities.motion(arm_at(), rows, 0.05, changes)
    assert found.ok.all()
    for k, one in enumerate(varied):
        for name, value in one.items():
            tips = [sensitivities.motion(arm_at(**{name: value + h}), rows, 0.05, ()).tip_m for h in (1e-3, -1e-3)]
            expected = (tips[0] - tips[1]) / 2e-3
            assert found.tip_by[:, :, k] == pytest.approx(expected, abs=2e-3 * np.abs(expected).max())


def test_one_call_moves_the_arm_as_many_steps_do() -> None:
    arm = viscous(variant="inhomogeneous+rpe", inertia=True, cap_mass_kg=0.05)
    rows = BAR * np.random.default_rng(1).uniform(0, 0.3, (6, 3))
    whole, single = Dynamics(arm, 1 / 30), Dynamics(arm, 1 / 30)
    whole.start(rows[0])
    single.start(rows[0])
    moved = whole.run(rows[1:]).tip_m
    assert np.array_equal(moved, [single.step(row).tip_m for row in rows[1:]])


@pytest.mark.parametrize(("modulus", "time_s", "problem"), [(-0.1, 1.0, "relative_modulus"), (0.1, 0.0, "time_s")])
def test_impossible_branches_are_refused(modulus: float, time_s: float, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        MaxwellBranch(modulus, time_s)


def test_too_many_branches_and_the_papers_formulation_are_refused() -> None:
    with pytest.raises(ValueError, match="at most 3"):
        viscous((MaxwellBranch(0.1, 1.0),) * 4)
    with pytest.raises(ValueError, match="viscous walls"):
        PaperRod(viscous()).start((0, 0, 0))
    one, two = viscous(BRANCHES[:1]), viscous()
    with pytest.raises(ValueError, match="branches"):
        sensitivities.motion(one, np.zeros((2, 3)), 0.1, [Variation(1e-7, two)])
