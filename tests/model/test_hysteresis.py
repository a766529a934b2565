"""Stop elements of the actuators: loop area, rate independence, congruency, dissipation, gradients, rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from model import Arm, sensitivities
from model.actuation import PressureSum, Proportional, StopElement
from model.arrays import Array
from model.dynamics import Dynamics
from model.hysteresis import Hysteresis, effective_pa
from model.statics import statics
from model.variation import Variation

BAR = 1e5
ELEMENTS = (StopElement(0.1, 0.02 * BAR), StopElement(0.05, 0.1 * BAR))
COURSES = st.lists(st.floats(0, 1e5), min_size=2, max_size=30)


def course(*corners_bar: float, parts: int = 1) -> Array:
    """Pressures (T, 1) [Pa] from corner to corner in so many even parts."""
    at = np.linspace(0, len(corners_bar) - 1, (len(corners_bar) - 1) * parts + 1)
    return BAR * np.interp(at, np.arange(len(corners_bar)), corners_bar)[:, None]


def loop_area(pressure: Array, effective: Array) -> float:
    """Integral of the pressure over the effective one [Pa^2]."""
    return float((0.5 * (pressure[1:] + pressure[:-1]) * np.diff(effective, axis=0)).sum())


def test_the_area_of_a_loop_is_the_closed_form() -> None:
    # A stop of width r on a cycle of range R encloses 2 r (R - 2 r).
    cycle = course(0.1, 0.6, 0.1, 0.6, 0.1, parts=200)
    effective = effective_pa(ELEMENTS, cycle)
    closed = sum(e.weight * 2 * e.width_pa * (0.5 * BAR - 2 * e.width_pa) for e in ELEMENTS)
    assert loop_area(cycle[400:], effective[400:]) == pytest.approx(closed, rel=1e-3)


@given(COURSES)
@settings(max_examples=50)
def test_no_closed_course_gains_energy(corners: list[float]) -> None:
    pressure = np.array([0.0, *corners, 0.0])[:, None]
    fine = np.interp(np.linspace(0, 1, 20 * len(pressure)), np.linspace(0, 1, len(pressure)), pressure[:, 0])[:, None]
    # What is left in the springs is less than what went in.
    assert loop_area(fine, effective_pa(ELEMENTS, fine)) >= -1e-6 * BAR**2


@given(COURSES, st.integers(1, 7))
@settings(max_examples=50)
def test_only_the_corners_matter_and_not_the_time_between_them(corners: list[float], parts: int) -> None:
    bar = [0.0, *(c / BAR for c in corners)]
    fine = effective_pa(ELEMENTS, course(*bar, parts=parts))[::parts]
    assert fine == pytest.approx(effective_pa(ELEMENTS, course(*bar)), abs=1e-6)


@given(st.lists(st.floats(0, 1), max_size=10), st.lists(st.floats(0, 1), max_size=10))
@settings(max_examples=50)
def test_loops_between_the_same_pressures_are_congruent(one: list[float], other: list[float]) -> None:
    loops = []
    for past in (one, other):
        pressure = course(0.0, *past, 0.2, 0.5, 0.2, parts=10)
        effective = effective_pa(ELEMENTS, pressure)[-21:]
        loops.append(effective - effective[0])
    # After the first branch, which the past still bends, the loops differ by a shift alone.
    assert loops[0][10:] - loops[0][-1] == pytest.approx(loops[1][10:] - loops[1][-1], abs=1e-6)


def test_the_operator_is_that_of_the_simulated_bench() -> None:
    from rig.arm_effects.effects import HysteresisSection, SlipElement

    rng = np.random.default_rng(2)
    pressure = np.vstack([np.zeros((1, 3)), rng.uniform(0, 0.6, (50, 3)) * BAR])
    elements = tuple(SlipElement(weight=e.weight, slip_bar=e.width_pa / BAR) for e in ELEMENTS)
    bench = HysteresisSection(type="hysteresis", elements=elements).effect(3, 1.0)
    expected = BAR * np.array([bench((row / BAR).tolist()) for row in pressure])
    assert effective_pa(ELEMENTS, pressure) == pytest.approx(expected, abs=1e-6)


def test_parts_of_a_course_continue_each_other() -> None:
    pressure = BAR * np.random.default_rng(3).uniform(0, 0.6, (20, 3))
    whole, parts = Hysteresis(ELEMENTS, pressure[0]), Hysteresis(ELEMENTS, pressure[0])
    split = np.vstack([parts.advance(pressure[:7]), parts.advance(pressure[7:])])
    assert np.array_equal(whole.advance(pressure), split)


@pytest.mark.parametrize("inertia", [True, False])
def test_the_arm_moves_as_under_the_effective_pressures(inertia: bool) -> None:
    elastic = replace(Arm.paper(), inertia=inertia, actuation=PressureSum(0.2))
    arm = replace(elastic, actuation=replace(elastic.actuation, stops=ELEMENTS))
    rows = BAR * np.random.default_rng(5).uniform(0, 0.4, (12, 3))
    whole, single, plain = (Dynamics(one, 1 / 30) for one in (arm, arm, elastic))
    for one in (whole, single, plain):
        one.start(rows[0])
    effective = effective_pa(ELEMENTS, rows)
    moved = whole.run(rows[1:]).tip_m
    assert np.array_equal(moved, plain.run(effective[1:]).tip_m)
    assert np.array_equal(moved, [single.step(row).tip_m for row in rows[1:]])
    assert np.array_equal(statics(arm, rows[1]).tip_m, statics(elastic, rows[1]).tip_m)


def test_gradients_are_those_of_finite_differences() -> None:
    t = np.linspace(0, 6, 60)
    rows = BAR * np.stack([0.3 * np.sin(t) ** 2, 0.1 * t / 6, 0.2 * np.cos(t) ** 2], axis=1)

    def arm_at(weight: float = 0.1, width_pa: float = 2e3) -> Arm:
        stops = (StopElement(weight, width_pa), ELEMENTS[1])
        return replace(Arm.paper("homogeneous"), inertia=False, actuation=Proportional(stops=stops))

    steps = {"weight": 1e-7, "width_pa": 1e-3}
    values = {"weight": 0.1, "width_pa": 2e3}
    changes = [Variation(h, arm_at(**{name: values[name] + h})) for name, h in steps.items()]
    pressed = Variation(0.01, arm_at(), rows + 0.01)
    found = sensitivities.motion(arm_at(), rows, 0.1, [*changes, pressed])
    for k, (name, h) in enumerate({"weight": 0.02, "width_pa": 20.0}.items()):
        tips = [sensitivities.motion(arm_at(**{name: values[name] + x}), rows, 0.1, ()).tip_m for x in (h, -h)]
        expected = (tips[0] - tips[1]) / (2 * h)
        gap = np.abs(found.tip_by[:, :, k] - expected).max(axis=1) / np.abs(expected).max()
        # A difference across the slip of an element is between both slopes.
        assert np.quantile(gap, 0.9) < 0.02


@pytest.mark.parametrize(("weight", "width_pa", "problem"), [(1.5, 1e3, "weight"), (0.1, 0.0, "width_pa")])
def test_impossible_elements_are_refused(weight: float, width_pa: float, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        StopElement(weight, width_pa)
    with pytest.raises(ValueError, match="at most 3"):
        Proportional(stops=(ELEMENTS[0],) * 4)
