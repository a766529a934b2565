"""Gradients of tip and sections with respect to parameters, pressures and loads, for identification.

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
from model.arrays import Array
from model.batch import ROWS_PER_THREAD, spread
from model.dynamics import Dynamics
from model.errors import NotConverged, Unstable
from model.hysteresis import effective_pa
from model.kernels import layout
from model.kernels.arguments import SectionSensitivities, TipSensitivities
from model.kernels.dynamic_sensitivities import dynamic_sensitivities
from model.kernels.lanes import SensitivityWorkspace, apply_tip_load
from model.kernels.shooting import TOLERANCE_AT_REST, TOLERANCE_IN_MOTION, workspace_for
from model.kernels.static_sensitivities import static_sensitivities
from model.perturbed_arms import PerturbedArms, lane_rows, lane_tip_loads
from model.pressures import pressures
from model.statics import steps_along
from model.variation import TipWrench, Variation

STEP = 1e-7
PRESSURE_STEP_PA = 0.01
# Reference magnitude for the step of a parameter that is zero.
USUAL = {"youngs_modulus_pa": 1e5, "rpe_per_bar": 0.05, "a1_per_n": 1e-2, "a2_per_n2": 1e-4, "shear_ratio": 0.4}


@dataclass(frozen=True)
class Gradients:
    """Poses of K tips and their derivatives with respect to P changes, per unit of the step of each change.

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
    """tip_m (3,); by_parameter: material field -> d tip / d field (3,), per its unit, those of the second segment as
    `segment_2.field`; by_pressure (3, N) [m/Pa]."""

    tip_m: Array
    by_parameter: dict[str, Array]
    by_pressure: Array


def tip_gradient(arm: Arm, pressure_pa: ArrayLike) -> TipGradient:
    """The tip at rest and its gradient by the section's material and the pressures. Raises as `statics` does."""
    pressure, nodes = pressures(arm, pressure_pa), steps_along(arm, None)
    names = _parameters(arm)
    if arm.by_pressure:
        stack = PerturbedArms.of(arm, _varied(arm, pressure), nodes, pressure[None])
    else:
        stack = _kept.stack(arm, nodes)
    tip_loads = np.zeros((1, len(stack.lanes.works), 12, layout.LANES))
    rows = pressure[:, None] + _shifts(len(names), len(pressure))
    tips, _ = _solve(
        stack, rows, tip_loads, nodes, _kept.workspace(len(stack.steps), nodes, _shooting_segments(arm, nodes))
    )
    if not tips.good[0]:
        raise (Unstable if tips.unstable[0] else NotConverged).at(pressure)
    by = tips.by[0, :, :3]
    return TipGradient(tips.place[0], dict(zip(names, by, strict=False)), by[len(names) :].T)


def statics(
    arm: Arm,
    pressure_pa: ArrayLike,
    changes: Sequence[Variation] = (),
    weight_kg: ArrayLike | None = None,
    tip_wrench: TipWrench | None = None,
    nodes: int | None = None,
    workers: int | None = None,
    sections_m: ArrayLike = (),
) -> Gradients:
    """Tips at rest for rows of pressure_pa (K, N) [Pa], with the derivatives for each change, on all cores.

    weight_kg (K,): masses at the tip. tip_wrench: K wrenches at the tip. sections_m (S,): arc lengths [m] of further
    sections to differentiate. Raises ValueError for arguments of the wrong shape or not finite.
    """
    rows, nodes = _rows(arm, pressure_pa), steps_along(arm, nodes)
    _check_changes(arm, changes, rows)
    at = _arc_lengths(arm, sections_m)
    tip_loads = lane_tip_loads(arm, changes, len(rows), weight_kg, tip_wrench)
    stack = PerturbedArms.of(arm, changes, nodes, rows)
    by_lane = lane_rows(rows, [change.pressure_pa for change in changes])
    parts: dict[int, Gradients] = {}

    def part(span: range) -> None:
        if len(span):
            own = slice(span.start, span.stop)
            workspace = SensitivityWorkspace.of(len(changes), nodes, _shooting_segments(arm, nodes))
            loads = tip_loads if len(tip_loads) == 1 else tip_loads[own]
            parts[span.start] = _gradients(*_solve(stack.own(own), by_lane[own], loads, nodes, workspace, at))

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
    tip_wrench: TipWrench | None = None,
    sections_m: ArrayLike = (),
) -> Gradients:
    """The tip in motion, from rest under the first row of pressure_pa (1 + T, N) [Pa], one time step for each row.

    Returns the first row and each `every`-th time step after it: K = 1 + T // every. weight_kg (1 + T,), tip_wrench
    (1 + T rows), sections_m: as of `statics`. The scheme is BDF-alpha. Raises ValueError for arguments of the wrong
    shape or not finite.
    """
    rows = _rows(arm, pressure_pa)
    _check_changes(arm, changes, rows)
    changes = [_with_hysteresis(change, arm, rows) for change in changes]
    rows = effective_pa(arm.actuation.stops, rows)
    if every < 1:
        raise ValueError(f"`every` must be at least 1 time step, got {every}")
    tip_loads = lane_tip_loads(arm, changes, len(rows), weight_kg, tip_wrench)
    count = 1 + (len(rows) - 1) // every
    tips = _empty_tips(count, len(changes))
    sections = _empty_sections(count, len(changes), _arc_lengths(arm, sections_m))
    dynamics = Dynamics(arm, dt_s, nodes=nodes)
    n = dynamics.nodes
    at_rest = PerturbedArms.of(arm, changes, n, rows[:1])
    ends = np.empty_like(at_rest.first.ends)
    apply_tip_load(at_rest.first.ends, tip_loads[0], ends)
    try:
        dynamics.start_from(at_rest.first, rows[0], ends, at_rest.load, at_rest.loaded)
    except NotConverged as fault:
        tips.unstable[0] = isinstance(fault, Unstable)
        return _gradients(*_without_failures(tips, sections))
    moving = PerturbedArms.of(arm, changes, n, rows, dynamics.c0, dt_s)
    first = moving.first
    arm_in_motion = dynamics.arm_with_cap._replace(rest=first.rest)
    dynamic_sensitivities(
        first.walls, tuple(arm_in_motion), tuple(dynamics.state), tuple(at_rest.lanes), tuple(moving.lanes),
        lane_rows(rows, [change.pressure_pa for change in changes]), tip_loads, moving.steps, every, dynamics.pool,
        tuple(SensitivityWorkspace.of(len(changes), n, dynamics.segments, arm.branches)),
        TOLERANCE_IN_MOTION, tuple(tips), tuple(sections),
    )  # fmt: skip
    return _gradients(*_without_failures(tips, sections))


def _with_hysteresis(change: Variation, arm: Arm, rows: Array) -> Variation:
    """The change with the effective pressures of its arm, where these differ from the pressures."""
    stops = change.arm.actuation.stops
    if not (stops or arm.actuation.stops):
        return change
    given = rows if change.pressure_pa is None else change.pressure_pa
    return replace(change, pressure_pa=effective_pa(stops, given))


def _empty_tips(count: int, changes: int) -> TipSensitivities:
    """Arrays for K rows and P changes, before the solution."""
    place, turned, by = np.empty((count, 3)), np.empty((count, 3, 3)), np.empty((count, changes, 6))
    return TipSensitivities(place, turned, by, np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_))


def _empty_sections(count: int, changes: int, at_m: Array) -> SectionSensitivities:
    """The same for the sections at arc lengths (S,)."""
    place, turned = np.empty((count, len(at_m), 3)), np.empty((count, len(at_m), 3, 3))
    return SectionSensitivities(at_m, place, turned, np.empty((count, len(at_m), changes, 6)))


def _without_failures(
    tips: TipSensitivities, sections: SectionSensitivities
) -> tuple[TipSensitivities, SectionSensitivities]:
    """The same with NaN in the rows without a solution."""
    failed = ~tips.good
    for poses in (tips, sections):
        poses.place[failed], poses.turned[failed], poses.by[failed] = np.nan, np.nan, np.nan
    return tips, sections


def _gradients(tip: TipSensitivities, sections: SectionSensitivities) -> Gradients:
    by, section_by = tip.by.swapaxes(-1, -2), sections.by.swapaxes(-1, -2)
    return Gradients(
        tip.place, tip.turned, tip.good, by[:, :3], by[:, 3:], tip.unstable,
        sections.place, sections.turned, section_by[:, :, :3], section_by[:, :, 3:],
    )  # fmt: skip


def _arc_lengths(arm: Arm, sections_m: ArrayLike) -> Array:
    at = np.array(sections_m, dtype=np.float64).reshape(-1)
    length = arm.length_m
    if not ((at >= 0) & (at <= length)).all():
        raise ValueError(f"sections lie on the arm, from 0 to {length:g} m, got {at.tolist()}")
    return at


def _rows(arm: Arm, pressure_pa: ArrayLike) -> Array:
    rows = np.array(pressure_pa, dtype=np.float64)
    actuators = arm.actuators
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
    """Fields of the materials that the sections depend on; those after the first segment have its number before."""
    return tuple(
        name if k == 0 else f"segment_{k + 1}.{name}"
        for k, segment in enumerate(arm.segments)
        for name in (*segment.law.parameters, "rpe_per_bar", "shear_ratio")
    )


def _varied(arm: Arm, pressure: Array) -> list[Variation]:
    """Changes of these fields, then of each pressure (N,)."""
    changes = []
    for k, segment in enumerate(arm.segments):
        for name in (*segment.law.parameters, "rpe_per_bar", "shear_ratio"):
            value = getattr(segment.material, name)
            # The step of a parameter that is zero is a fraction of its usual magnitude.
            step = STEP * abs(value) or STEP * USUAL.get(name, 1.0)
            material = replace(segment.material, **{name: value + step})
            changes.append(Variation(step, arm.with_segment(k, material=material)))
    pressed = pressure + PRESSURE_STEP_PA * np.eye(len(pressure))
    return changes + [Variation(PRESSURE_STEP_PA, arm, own[None]) for own in pressed]


@lru_cache(maxsize=16)
def _shifts(fields: int, actuators: int) -> Array:
    """Differences of the pressures of these lanes from those of the arm, (1, W, N, 8) [Pa]."""
    still = np.zeros((1, actuators))
    return lane_rows(still, [still] * fields + list(PRESSURE_STEP_PA * np.eye(actuators)[:, None]))


class _Kept(threading.local):
    """Arrays that `tip_gradient` writes to, allocated once for each thread."""

    def __init__(self) -> None:
        self.stack = lru_cache(maxsize=64)(_stack_of_material)
        self.workspace = lru_cache(maxsize=8)(_workspace_at_rest)


def _stack_of_material(arm: Arm, nodes: int) -> PerturbedArms:
    nothing = np.zeros(arm.actuators)
    return PerturbedArms.of(arm, _varied(arm, nothing), nodes, nothing[None])


def _workspace_at_rest(copies: int, nodes: int, segments: int) -> SensitivityWorkspace:
    return SensitivityWorkspace.of(copies, nodes, segments)


def _shooting_segments(arm: Arm, nodes: int) -> int:
    """Shooting segments of an arm at rest: as many as its own at least, because a change grows along each of them."""
    return next(d for d in range(len(arm.segments), nodes + 1) if nodes % d == 0)


_kept = _Kept()


_NO_SECTIONS = np.empty(0)


def _solve(
    stack: PerturbedArms,
    rows: Array,
    tip_loads: Array,
    nodes: int,
    workspace: SensitivityWorkspace,
    at_m: Array = _NO_SECTIONS,
) -> tuple[TipSensitivities, SectionSensitivities]:
    """Solve for pressures (K, W, N, 8) [Pa]; writes to the work arrays of the stack."""
    count, first = len(rows), stack.first
    arm = first.arm(stack.work, first.ends, stack.load, stack.loaded, stack.first_nodes)
    pool, _ = workspace_for(nodes)
    tips, sections = _empty_tips(count, len(stack.steps)), _empty_sections(count, len(stack.steps), at_m)
    static_sensitivities(
        first.walls, tuple(arm), tuple(stack.lanes), rows, tip_loads, stack.steps, pool, tuple(workspace),
        TOLERANCE_AT_REST, tuple(tips), tuple(sections),
    )  # fmt: skip
    return tips, sections
