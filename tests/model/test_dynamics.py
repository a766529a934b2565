"""The arm in motion: rest, frequencies, energy, order in space, and steps that cannot be solved."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.integrate import simpson
from scipy.optimize import brentq

from model import Arm, Loads
from model.actuation import StopElement
from model.dynamics import Dynamics
from model.material import MaxwellBranch
from model.statics import statics
from tests.support.budget import examples

BAR = 1e5
variants = ("homogeneous", "homogeneous+rpe", "inhomogeneous+rpe")


def frequency(signal: NDArray[np.float64], dt_s: float) -> float:
    """Angular frequency of the strongest line, the trapezoidal rule's own warping undone."""
    window = (signal - signal.mean()) * np.hanning(len(signal))
    spectrum = np.abs(np.fft.rfft(window, 16 * len(signal)))
    discrete = 2 * math.pi * np.fft.rfftfreq(16 * len(signal), dt_s)[int(spectrum.argmax())]
    return 2 / dt_s * math.tan(discrete * dt_s / 2)


@pytest.mark.parametrize("variant", variants)
def test_an_arm_at_rest_stays_at_rest(variant: str) -> None:
    dynamics = Dynamics(Arm.paper(variant), 1 / 30)
    p = np.array([0.5, 0.2, 0.1]) * BAR
    start = dynamics.start(p).p_m
    assert max(np.abs(dynamics.step(p).p_m - start).max() for _ in range(30)) < 3e-8


@pytest.mark.parametrize("variant", variants)
def test_it_starts_and_settles_at_the_static_shape(variant: str) -> None:
    arm = Arm.paper(variant)
    arm = arm.with_segment(material=replace(arm.material, damping_s=0.02))
    p = np.array([0.4, 0.0, 0.2]) * BAR
    dynamics = Dynamics(arm, 1 / 100, "bdf1")
    assert np.abs(dynamics.start((0, 0, 0)).tip_m - statics(arm, (0, 0, 0)).tip_m).max() < 1e-8
    for _ in range(400):
        shape = dynamics.step(p)
    assert np.abs(shape.tip_m - statics(arm, p).tip_m).max() < 1e-7


@pytest.mark.parametrize(
    ("axis", "kick", "rad_s"),
    [
        (0, Loads(tip_force_n=(0.02, 0, 0)), 41.2),
        (1, Loads(tip_force_n=(0, 0.02, 0)), 41.3),
        (2, Loads(tip_force_n=(0, 0, 0.05)), 145.0),
        (3, Loads(tip_moment_n_m=(0, 0, 0.001)), 96.8),
    ],
)
def test_the_first_modes_have_the_known_frequencies(axis: int, kick: Loads, rad_s: float) -> None:
    # One actuator at 0.35 bar, 50 g, radial pressure effect; an independent model gave these four.
    dt = 0.002
    dynamics = Dynamics(Arm.paper("homogeneous+rpe"), dt, "trapezoidal", nodes=24)
    p = (0.35 * BAR, 0, 0)
    dynamics.start(p)
    still = Loads()
    signal = []
    for k in range(2000):
        shape = dynamics.step(p, kick if k < 5 else still)
        assert shape.ok
        twist = shape.tip_rotation[1, 0] - shape.tip_rotation[0, 1]
        signal.append(twist if axis == 3 else shape.tip_m[axis])
    found = frequency(np.array(signal), dt)
    # The bent arm couples what the straight one keeps apart: for the axial kick look above the bending mode.
    if axis >= 2 and found < 60:
        x = np.array(signal) - np.mean(signal)
        spectrum = np.fft.rfft(x * np.hanning(len(x)))
        spectrum[: int(60 * len(x) * dt / (2 * math.pi))] = 0
        found = frequency(np.fft.irfft(spectrum), dt)
    assert found == pytest.approx(rad_s, rel=0.006)


def test_the_frequencies_of_a_thin_cantilever_are_those_of_the_textbook() -> None:
    # Long, slender, no load: (1.8751 / L)^2 sqrt(E I / rho A), lowered by shear and rotary inertia by under 1 %.
    arm = Arm.paper("homogeneous")
    geometry = replace(arm.geometry, length_m=2.0)
    arm = replace(arm, gravity_m_s2=(0.0, 0.0, 0.0)).with_segment(geometry=geometry)
    bending = 289142.05 * (3 * geometry.wall_second_moment_m4 + geometry.wall_area_m2 * 0.055**2 / 2)
    book = (1.875104 / 2.0) ** 2 * math.sqrt(bending / arm.line_density_kg_m)
    dt = 2 * math.pi / book / 60
    dynamics = Dynamics(arm, dt, "trapezoidal", nodes=40)
    push = Loads(tip_force_n=(1e-4, 0, 0))
    dynamics.start((0, 0, 0), push)
    still = Loads()
    signal = np.array([dynamics.step((0, 0, 0), still).tip_m[0] for _ in range(900)])
    assert frequency(signal, dt) == pytest.approx(book, rel=0.01)


def energy(arm: Arm, dynamics: Dynamics) -> float:
    """Kinetic plus elastic energy of a linear section without pressure, from the solver's own states."""
    from model.section import section

    x = dynamics._x[: dynamics.nodes + 1]
    g = arm.geometry
    law = section(g, g.positions_m, np.full(3, arm.stiffness_n), arm.material.shear_ratio, 0.0)
    strain = x[:, :6] - np.array([0, 0, 1.0, 0, 0, 0])
    axial, shear = strain[:, [2, 3, 4]], strain[:, [0, 1, 5]]
    elastic = np.einsum("ni,ij,nj->n", axial, law.axial, axial) + np.einsum("ni,ij,nj->n", shear, law.shear, shear)
    second = 3 * g.wall_second_moment_m4 + g.wall_area_m2 * 0.055**2 / 2
    inertia = arm.material.density_kg_m3 * second * np.array([1, 1, 2])
    kinetic = arm.line_density_kg_m * (x[:, 6:9] ** 2).sum(1) + (inertia * x[:, 9:12] ** 2).sum(1)
    return float(simpson(0.5 * (elastic + kinetic), dx=g.length_m / (len(x) - 1)))


def test_the_trapezoidal_rule_keeps_the_energy_and_backward_euler_loses_it() -> None:
    arm = replace(Arm.paper("homogeneous"), gravity_m_s2=(0.0, 0.0, 0.0))
    pull = Loads(tip_force_n=(0.5, 0.3, 0.0))
    kept = {}
    for scheme in ("trapezoidal", "bdf1"):
        dynamics = Dynamics(arm, 0.001, scheme)
        dynamics.start((0, 0, 0), pull)
        first = energy(arm, dynamics)
        still = Loads()
        for _ in range(300):
            assert dynamics.step((0, 0, 0), still).ok
        kept[scheme] = energy(arm, dynamics) / first
    assert kept["trapezoidal"] == pytest.approx(1.0, abs=0.01)
    assert kept["bdf1"] < 0.8


def test_oscillations_decay_at_the_kelvin_voigt_rate() -> None:
    # One mode of a Kelvin-Voigt rod decays as exp(-tau omega^2 t / 2).
    tau, dt = 0.002, 0.001
    arm = replace(Arm.paper("homogeneous"), cap_mass_kg=0.0)
    arm = arm.with_segment(material=replace(arm.material, damping_s=tau))
    dynamics = Dynamics(arm, dt, "trapezoidal")
    dynamics.start((0, 0, 0), Loads(tip_force_n=(0.01, 0, 0)))
    still = Loads()
    signal = np.array([dynamics.step((0, 0, 0), still).tip_m[0] for _ in range(800)])
    peaks = [k for k in range(1, 799) if signal[k - 1] < signal[k] > signal[k + 1]]
    omega = 2 * math.pi / (np.diff(peaks).mean() * dt)
    decay = -math.log(signal[peaks[-1]] / signal[peaks[1]]) / ((peaks[-1] - peaks[1]) * dt)
    assert decay == pytest.approx(tau * omega**2 / 2, rel=0.03)


@pytest.mark.parametrize("variant", ["homogeneous+rpe", "inhomogeneous+rpe"])
def test_damping_changes_no_equilibrium(variant: str) -> None:
    arm = Arm.paper(variant)
    damped = arm.with_segment(material=replace(arm.material, damping_s=0.05))
    p = (0.5 * BAR, 0.1 * BAR, 0)
    assert np.array_equal(statics(arm, p).tip_m, statics(damped, p).tip_m)
    dynamics = Dynamics(damped, 0.01)
    dynamics.start(p)
    assert np.abs(dynamics.step(p).tip_m - statics(arm, p, nodes=80).tip_m).max() < 1e-7


@pytest.mark.parametrize("variant", ["homogeneous+rpe", "inhomogeneous+rpe"])
def test_the_history_between_nodes_keeps_the_fourth_order_in_space(variant: str) -> None:
    arm = Arm.paper(variant)
    arm = arm.with_segment(material=replace(arm.material, damping_s=0.01))

    def tip(nodes: int) -> NDArray[np.float64]:
        dynamics = Dynamics(arm, 1 / 30, nodes=nodes)
        dynamics.start((0.1 * BAR, 0.1 * BAR, 0.1 * BAR))
        for k in range(10):
            shape = dynamics.step(((0.1 + 0.02 * k) * BAR, 0.1 * BAR, 0.1 * BAR))
        return shape.tip_m

    fine = tip(64)
    coarse, half = np.abs(tip(6) - fine).max(), np.abs(tip(12) - fine).max()
    assert coarse / half > 11
    assert half < 1e-6


def test_the_default_steps_along_the_arm_suffice_at_every_time_step() -> None:
    for dt in (0.001, 0.005, 1 / 30):
        tips = []
        for refine in (1, 3):
            dynamics = Dynamics(Arm.paper("homogeneous+rpe"), dt)
            if refine > 1:
                dynamics = Dynamics(Arm.paper("homogeneous+rpe"), dt, nodes=refine * dynamics.nodes)
            dynamics.start((0.3 * BAR, 0, 0))
            for k in range(40):
                shape = dynamics.step(((0.3 + 0.1 * math.sin(3 * k * dt)) * BAR, 0, 0))
            tips.append(shape.tip_m)
        assert np.abs(tips[0] - tips[1]).max() < 1e-6, dt


@pytest.mark.parametrize("dt", [0.001, 0.005, 1 / 30, 1 / 15])
@pytest.mark.parametrize("variant", ["homogeneous+rpe", "inhomogeneous+rpe"])
def test_no_random_jump_within_the_papers_range_fails(dt: float, variant: str) -> None:
    rng = np.random.default_rng(20240131)
    dynamics = Dynamics(Arm.paper(variant), dt)
    dynamics.start((0, 0, 0))
    for _ in range(150):
        shape = dynamics.step(rng.uniform(0, 0.65 * BAR, 3))
        assert shape.ok
        assert np.isfinite(shape.p_m).all()


@pytest.mark.slow
def test_thousands_of_jumps_a_millisecond_apart_do_not_fail_once() -> None:
    """Step 8737 of these needs pressures that are led in strides shorter than an eighth of the jump."""
    dynamics = Dynamics(Arm.paper("inhomogeneous+rpe"), 0.001)
    dynamics.start((0, 0, 0))
    run = dynamics.run(np.random.default_rng(424242).uniform(0, 0.65, (8800, 3)) * BAR)
    assert run.ok.all()


@pytest.mark.parametrize("scheme", ["bdf1", "bdf-alpha"])
@pytest.mark.parametrize(
    "change",
    [{"rod_weight": True}, {"cap_inertia": True}, {"gravity_m_s2": (0.0, 0.0, -9.81)}],
)
@pytest.mark.parametrize("damping_s", [0.0, 0.01])
def test_random_jumps_do_not_fail_with_any_option(scheme: str, change: dict[str, object], damping_s: float) -> None:
    arm = replace(Arm.paper(), **change)  # type: ignore[arg-type]
    arm = arm.with_segment(material=replace(arm.material, damping_s=damping_s))
    dynamics = Dynamics(arm, 0.005, scheme)
    dynamics.start((0, 0, 0))
    run = dynamics.run(np.random.default_rng(11).uniform(0, 0.65 * BAR, (80, 3)))
    assert run.ok.all()
    assert np.isfinite(run.tip_m).all()


def test_the_same_pressures_give_the_same_motion_bit_for_bit() -> None:
    def run() -> NDArray[np.float64]:
        rng = np.random.default_rng(5)
        dynamics = Dynamics(Arm.paper(), 0.005)
        dynamics.start((0, 0, 0))
        return np.array([dynamics.step(rng.uniform(0, 0.3 * BAR, 3)).tip_m for _ in range(20)])

    assert np.array_equal(run(), run())


def test_a_restored_motion_repeats_bit_for_bit() -> None:
    # Branches and stops remember, too.
    arm = Arm.paper()
    arm = replace(arm, actuation=replace(arm.actuation, stops=(StopElement(0.1, 2e3),))).with_segment(
        material=replace(arm.material, branches=(MaxwellBranch(0.2, 0.7),))
    )
    rows = 5e4 * np.random.default_rng(1).random((40, 3))
    dynamics = Dynamics(arm, 0.01)
    dynamics.start(rows[0])
    dynamics.run(rows[1:20])
    saved = dynamics.saved()
    first = dynamics.run(rows[20:]).tip_m
    dynamics.restore(saved)
    assert (dynamics.run(rows[20:]).tip_m == first).all()
    dynamics.restore(saved)
    assert (np.array([dynamics.step(row).tip_m for row in rows[20:]]) == first).all()


def test_a_step_that_cannot_be_solved_is_flagged_and_the_motion_continues() -> None:
    dynamics = Dynamics(Arm.paper("homogeneous"), 1 / 30)
    good = dynamics.start((0.1 * BAR, 0, 0))
    bad = dynamics.step((1e12, -1e12, 0))
    assert not bad.ok
    assert np.array_equal(bad.p_m, good.p_m)
    after = dynamics.step((0.1 * BAR, 0, 0))
    assert after.ok
    assert np.abs(after.tip_m - good.tip_m).max() < 1e-9


@examples(15)
@given(st.lists(st.tuples(*[st.floats(-1e6, 1e6)] * 3), min_size=1, max_size=6), st.sampled_from(variants))
def test_every_step_is_finite_for_any_pressures(pressures: list[tuple[float, ...]], variant: str) -> None:
    dynamics = Dynamics(Arm.paper(variant), 0.01)
    dynamics.start((0, 0, 0))
    for p in pressures:
        shape = dynamics.step(p)
        assert np.isfinite(shape.p_m).all()


def test_a_removed_distributed_load_has_no_further_effect() -> None:
    arm, p = Arm.paper("homogeneous"), (0.1 * BAR, 0, 0)
    load, next_to_none = Loads(force_n_per_m=(2, 0, 0)), Loads(force_n_per_m=(1e-12, 0, 0))
    tips = []
    for last in (None, next_to_none):
        dynamics = Dynamics(arm, 1 / 30)
        dynamics.start(p, load)
        dynamics.step(p, load)
        tips.append(np.array([dynamics.step(p, last).tip_m for _ in range(5)]))
    assert np.abs(tips[0] - tips[1]).max() < 1e-9


def test_a_step_before_the_start_is_refused() -> None:
    with pytest.raises(ValueError, match="start"):
        Dynamics(Arm.paper(), 0.01).step((0, 0, 0))


def test_pressures_that_are_not_finite_are_refused() -> None:
    dynamics = Dynamics(Arm.paper(), 0.01)
    dynamics.start((0, 0, 0))
    with pytest.raises(ValueError, match="finite"):
        dynamics.step((math.nan, 0, 0))


def test_the_caps_inertia_slows_the_first_mode_as_the_textbook_says() -> None:
    # A slender cantilever of mass m with M at its end: 1 + cos b cosh b + M/m b (cos b sinh b - sin b cosh b) = 0.
    arm = Arm.paper("homogeneous")
    geometry = replace(arm.geometry, length_m=2.0)
    arm = replace(arm, gravity_m_s2=(0.0, 0.0, 0.0), cap_mass_kg=0.5, cap_inertia=True).with_segment(geometry=geometry)
    ratio = 0.5 / (arm.line_density_kg_m * 2.0)

    def mode(b: float) -> float:
        beam = 1 + math.cos(b) * math.cosh(b)
        return beam + ratio * b * (math.cos(b) * math.sinh(b) - math.sin(b) * math.cosh(b))

    bending = 289142.05 * (3 * geometry.wall_second_moment_m4 + geometry.wall_area_m2 * 0.055**2 / 2)
    book = (brentq(mode, 0.5, 1.875) / 2.0) ** 2 * math.sqrt(bending / arm.line_density_kg_m)
    dt = 2 * math.pi / book / 60
    dynamics = Dynamics(arm, dt, "trapezoidal", nodes=40)
    dynamics.start((0, 0, 0), Loads(tip_force_n=(1e-4, 0, 0)))
    still = Loads()
    signal = np.array([dynamics.step((0, 0, 0), still).tip_m[0] for _ in range(900)])
    assert frequency(signal, dt) == pytest.approx(book, rel=0.01)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"dt_s": 0.0}, "time step"),
        ({"dt_s": math.nan}, "time step"),
        ({"dt_s": 0.01, "scheme": "rk4"}, "bdf-alpha"),
        ({"dt_s": 0.01, "alpha": 0.1}, "alpha"),
        ({"dt_s": 0.01, "nodes": 1}, "two steps"),
        ({"dt_s": 0.001, "nodes": 12}, "needs at least"),
        ({"dt_s": 1e-9}, "too short"),
    ],
)
def test_an_invalid_time_stepper_is_refused(arguments: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Dynamics(Arm.paper(), **arguments)  # type: ignore[arg-type]
