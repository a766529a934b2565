"""Exact gradients of tip and sections by parameters and pressures, for identification.

By the implicit function theorem (model/kernels/tangents.py): tangent vectors of a solved arm are integrated beside it,
without further Newton iterations.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model.arm import Arm
from model.batch import ROWS_PER_THREAD, spread
from model.dynamics import Dynamics
from model.errors import NotConverged, Unstable
from model.hysteresis import effective_pa
from model.kernels import layout
from model.kernels.arguments import SectionAnswers, TipAnswers
from model.kernels.dynamic_sensitivities import dynamic_sensitivities
from model.kernels.lanes import Lanes, apply_tip_load
from model.kernels.shooting import TOLERANCE_AT_REST, TOLERANCE_IN_MOTION, workspace_for
from model.kernels.static_sensitivities import static_sensitivities
from model.loads import Loads
from model.perturbed_arms import PerturbedArms, lane_rows, lane_tip_loads
from model.pressures import pressures
from model.statics import steps_along
from model.variation import TipWrench, Variation

Array = NDArray[np.float64]

STEP = 1e-7
PRESSURE_STEP_PA = 0.01
# Reference magnitude for the step of a parameter that is zero.
USUAL = {"youngs_modulus_pa": 1e5, "rpe_per_bar": 0.05, "a1_per_n": 1e-2, "a2_per_n2": 1e-4, "shear_ratio": 0.4}


@dataclass(frozen=True)
class Gradients:
    """K tips and how they answer to P changes, per unit of each change's step.

    tip_m (K, 3), tip_rotation (K, 3, 3), ok (K,). tip_by (K, 3, P) [m]; turn_by (K, 3, P) [rad]: rotation vector in
    the base frame. NaN where there is no stable solution; unstable (K,) where an unstable equilibrium was found.
    section_m (K, S, 3), section_rotation (K, S, 3, 3), section_by (K, S, 3, P), section_turn_by (K, S, 3, P): the same
    of the S sections that were asked for.
    """

    tip_m: Array
    tip_rotation: Array
    ok: NDArray[np.bool_]
    tip_by: Array
    turn_by: Array
    unstable: NDArray[np.bool_]
    section_m: Array
    section_rotation: Array
    section_by: Array
    section_turn_by: Array


@dataclass(frozen=True)
class TipGradient:
    """tip_m (3,); by_parameter: material field -> d tip / d field (3,), per its unit; by_pressure (3, N) [m/Pa]."""

    tip_m: Array
    by_parameter: dict[str, Array]
    by_pressure: Array


def tip_gradient(arm: Arm, pressure_pa: ArrayLike, loads: Loads | None = None, nodes: int | None = None) -> TipGradient:
    """The tip at rest and its gradient by the section's material and the pressures. Raises as `statics` does."""
    pressure, nodes = pressures(arm, pressure_pa), steps_along(arm, nodes)
    names = _parameters(arm)
    if arm.by_pressure:
        stack = PerturbedArms.of(arm, _varied(arm, pressure), nodes, pressure[None])
    else:
        stack = _kept.stack(arm, nodes)
    tip_loads = np.zeros((1, len(stack.lanes.works), 12, layout.LANES))
    if loads is not None:
        load, loaded = stack.first.load(arm, loads, nodes)
        # What is kept must not remember a load.
        stack = stack.own(slice(None))
        stack = replace(
            stack, lanes=stack.lanes._replace(loaded=loaded or stack.lanes.loaded), load=load, loaded=loaded
        )
        tip_loads = tip_loads + np.concatenate([loads.tip(), loads.pull()])[:, None]
    rows = pressure[:, None] + _shifts(len(names), len(pressure))
    found = _solve(stack, rows, tip_loads, nodes, _kept.lanes(len(stack.steps), nodes))
    if not found.ok[0]:
        raise (Unstable if found.unstable[0] else NotConverged).at(pressure)
    by = found.tip_by[0]
    return TipGradient(found.tip_m[0], dict(zip(names, by.T, strict=False)), by[:, len(names) :])


def statics(
    arm: Arm,
    pressure_pa: ArrayLike,
    changes: Sequence[Variation] = (),
    weight_kg: ArrayLike | None = None,
    pull: TipWrench | None = None,
    nodes: int | None = None,
    workers: int | None = None,
    sections_m: ArrayLike = (),
) -> Gradients:
    """Tips at rest for rows of pressure_pa (K, N) [Pa], and how they answer to each change, in one call on all cores.

    weight_kg (K,), pull (K rows): hang on the tip. sections_m (S,): arc lengths [m] of sections of the arm at rest that
    are asked for, too. Raises ValueError for what does not fit.
    """
    rows, nodes = _rows(arm, pressure_pa), steps_along(arm, nodes)
    _check_changes(arm, changes, rows)
    at = _arc_lengths(arm, sections_m)
    tip_loads = lane_tip_loads(arm, changes, len(rows), weight_kg, pull)
    stack = PerturbedArms.of(arm, changes, nodes, rows)
    by_lane = lane_rows(rows, [change.pressure_pa for change in changes])
    parts: dict[int, Gradients] = {}

    def part(span: range) -> None:
        if len(span):
            own = slice(span.start, span.stop)
            workspace = Lanes.of(len(changes), nodes, 1)
            parts[span.start] = _solve(
                stack.own(own), by_lane[own], tip_loads if len(tip_loads) == 1 else tip_loads[own], nodes, workspace, at
            )

    spread(part, len(rows), workers, ROWS_PER_THREAD)
    each = [parts[start] for start in sorted(parts)]
    return Gradients(*(np.concatenate([getattr(one, f.name) for one in each]) for f in fields(Gradients)))


def motion(
    arm: Arm,
    pressure_pa: ArrayLike,
    dt_s: float,
    changes: Sequence[Variation],
    weight_kg: ArrayLike | None = None,
    every: int = 1,
    nodes: int | None = None,
    pull: TipWrench | None = None,
    sections_m: ArrayLike = (),
) -> Gradients:
    """The tip in motion, from rest under the first of the rows of pressure_pa (1 + T, N) [Pa], one time step a row.

    Answers of the first row and of `every` so many steps after it: K = 1 + T // every. weight_kg (1 + T,), pull
    (1 + T rows): hang on the tip. sections_m: as of `statics`. The scheme is BDF-alpha. Raises ValueError for what does
    not fit.
    """
    rows = _rows(arm, pressure_pa)
    _check_changes(arm, changes, rows)
    changes = [_with_hysteresis(change, arm, rows) for change in changes]
    rows = effective_pa(arm.actuation.stops, rows)
    if every < 1:
        raise ValueError(f"answers are asked for every so many steps, at least 1, got {every}")
    tip_loads = lane_tip_loads(arm, changes, len(rows), weight_kg, pull)
    count, neighbours = 1 + (len(rows) - 1) // every, len(changes)
    answers = _no_answers(count, neighbours)
    sections = _no_sections(count, neighbours, _arc_lengths(arm, sections_m))
    dynamics = Dynamics(arm, dt_s, nodes=nodes)
    n = dynamics.nodes
    still = PerturbedArms.of(arm, changes, n, rows[:1])
    here = np.empty(layout.HANGS)
    apply_tip_load(still.first.cap, tip_loads[0], here)
    try:
        dynamics.begin(still.first, rows[0], here, still.load, still.loaded)
    except NotConverged as fault:
        answers.unstable[0] = isinstance(fault, Unstable)
        return _gradients(answers, sections)
    swinging = PerturbedArms.of(arm, changes, n, rows, dynamics.c0, dt_s)
    arm_in_motion = dynamics.arm_with_cap._replace(
        stiffness=swinging.first.stiffness, rest=swinging.first.rest, per_pressure=swinging.first.per_pressure
    )
    works, branches = len(swinging.lanes.works), len(arm.material.branches)
    dynamic_sensitivities(
        swinging.first.walls, arm_in_motion, dynamics.state, still.lanes, still.first.scale, swinging.lanes,
        lane_rows(rows, [change.pressure_pa for change in changes]), tip_loads, swinging.steps, every,
        layout.aligned(works, n + 1, (36 if branches else 24) * layout.LANES),
        layout.aligned(works, branches, n + 1, 12 * layout.LANES), dynamics.workspace,
        Lanes.of(neighbours, n, dynamics.segments), TOLERANCE_IN_MOTION, answers, sections,
    )  # fmt: skip
    lost = ~answers.good
    for found in (answers, sections):
        found.place[lost], found.turned[lost], found.by[lost] = np.nan, np.nan, np.nan
    return _gradients(answers, sections)


def _with_hysteresis(change: Variation, arm: Arm, rows: Array) -> Variation:
    """The change with the effective pressures of its arm, where these differ from the pressures."""
    stops = change.arm.actuation.stops
    if not (stops or arm.actuation.stops):
        return change
    given = rows if change.pressure_pa is None else change.pressure_pa
    return replace(change, pressure_pa=effective_pa(stops, given))


def _no_answers(count: int, neighbours: int) -> TipAnswers:
    """Answers of K rows by P changes, nothing solved yet."""
    place, turned = np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan)
    by, unstable = np.full((count, neighbours, 6), np.nan), np.zeros(count, dtype=np.bool_)
    return TipAnswers(place, turned, by, np.zeros(count, dtype=np.bool_), unstable)


def _no_sections(count: int, neighbours: int, at_m: Array) -> SectionAnswers:
    """The same of the sections at arc lengths (S,)."""
    place, turned = np.full((count, len(at_m), 3), np.nan), np.full((count, len(at_m), 3, 3), np.nan)
    return SectionAnswers(at_m, place, turned, np.full((count, len(at_m), neighbours, 6), np.nan))


def _gradients(tip: TipAnswers, sections: SectionAnswers) -> Gradients:
    by, section_by = tip.by.swapaxes(-1, -2), sections.by.swapaxes(-1, -2)
    return Gradients(
        tip.place, tip.turned, tip.good, by[:, :3], by[:, 3:], tip.unstable,
        sections.place, sections.turned, section_by[:, :, :3], section_by[:, :, 3:],
    )  # fmt: skip


def _arc_lengths(arm: Arm, sections_m: ArrayLike) -> Array:
    at = np.array(sections_m, dtype=np.float64).reshape(-1)
    length = arm.geometry.length_m
    if not ((at >= 0) & (at <= length)).all():
        raise ValueError(f"sections lie on the arm, from 0 to {length:g} m, got {at.tolist()}")
    return at


def _rows(arm: Arm, pressure_pa: ArrayLike) -> Array:
    rows = np.array(pressure_pa, dtype=np.float64)
    actuators = arm.geometry.actuators
    if rows.ndim != 2 or rows.shape[1] != actuators or not len(rows):
        raise ValueError(f"pressure_pa must be rows of {actuators} numbers, got shape {rows.shape}")
    return rows


def _check_changes(arm: Arm, changes: Sequence[Variation], rows: Array) -> None:
    if not np.isfinite(rows).all():
        raise ValueError("pressures must be finite")
    for change in changes:
        if change.arm.kind != arm.kind:
            raise ValueError("a change must keep the number of actuators and of branches, and the laws of the arm")
        if not (np.isfinite(change.step) and change.step != 0):
            raise ValueError(f"a change needs a step that is not zero, got {change.step}")
        if change.pressure_pa is not None and change.pressure_pa.shape != rows.shape:
            raise ValueError(f"a change has pressures of shape {change.pressure_pa.shape}, the arm {rows.shape}")


def _parameters(arm: Arm) -> tuple[str, ...]:
    """The material's fields that the section rests on."""
    return (*arm.law.parameters, "rpe_per_bar", "shear_ratio")


def _varied(arm: Arm, pressure: Array) -> list[Variation]:
    """Changes of these fields and then of each pressure (N,)."""
    changes = []
    for name in _parameters(arm):
        value = getattr(arm.material, name)
        # A parameter that is zero, such as no effect of the radial pressure, moves by a share of what is usual.
        step = STEP * abs(value) or STEP * USUAL.get(name, 1.0)
        changes.append(Variation(step, replace(arm, material=replace(arm.material, **{name: value + step}))))
    pressed = pressure + PRESSURE_STEP_PA * np.eye(len(pressure))
    return changes + [Variation(PRESSURE_STEP_PA, arm, own[None]) for own in pressed]


@lru_cache(maxsize=16)
def _shifts(fields: int, actuators: int) -> Array:
    """What the pressures of these lanes differ by, (1, W, N, 8) [Pa]."""
    still = np.zeros((1, actuators))
    return lane_rows(still, [still] * fields + list(PRESSURE_STEP_PA * np.eye(actuators)[:, None]))


class _Kept(threading.local):
    """What `tip_gradient` works in, made once per thread: its arrays are written to."""

    def __init__(self) -> None:
        self.stack = lru_cache(maxsize=64)(_stack_of_material)
        self.lanes = lru_cache(maxsize=8)(_lanes_at_rest)


def _stack_of_material(arm: Arm, nodes: int) -> PerturbedArms:
    nothing = np.zeros(arm.geometry.actuators)
    return PerturbedArms.of(arm, _varied(arm, nothing), nodes, nothing[None])


def _lanes_at_rest(neighbours: int, nodes: int) -> Lanes:
    return Lanes.of(neighbours, nodes, 1)


_kept = _Kept()


_NO_SECTIONS = np.empty(0)


def _solve(
    stack: PerturbedArms, rows: Array, tip_loads: Array, nodes: int, workspace: Lanes, at_m: Array = _NO_SECTIONS
) -> Gradients:
    """For pressures (K, W, N, 8); the stack's work arrays are written to."""
    count, first, neighbours = len(rows), stack.first, len(stack.steps)
    arm = first.arm(stack.work, first.cap, stack.load, stack.loaded)
    answers, sections = _no_answers(count, neighbours), _no_sections(count, neighbours, at_m)
    static_sensitivities(
        first.walls,
        arm,
        stack.lanes,
        rows,
        tip_loads,
        stack.steps,
        workspace_for(nodes),
        workspace,
        TOLERANCE_AT_REST,
        answers,
        sections,
    )
    return _gradients(answers, sections)
