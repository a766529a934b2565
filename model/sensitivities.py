"""Exact gradients of the tip by parameters and pressures, for identification.

By the implicit function theorem (model/kernels/tangents.py): tangent vectors of a solved arm are integrated beside it,
without further Newton iterations.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model.arm import Arm
from model.batch import ROWS_PER_THREAD, spread
from model.dynamics import Dynamics
from model.errors import NotConverged, Unstable
from model.hysteresis import effective_pa
from model.kernel_arguments import KernelArguments
from model.kernels import layout
from model.kernels.arguments import LaneArguments, TipAnswers
from model.kernels.dynamic_sensitivities import dynamic_sensitivities
from model.kernels.lanes import FIRST, Lanes, apply_tip_load, passes
from model.kernels.shooting import TOLERANCE_AT_REST, TOLERANCE_IN_MOTION, workspace_for
from model.kernels.static_sensitivities import static_sensitivities
from model.loads import Loads
from model.pressures import pressures
from model.statics import steps_along
from model.viscoelasticity import branch_factors

Array = NDArray[np.float64]

STEP = 1e-7
PRESSURE_STEP_PA = 0.01
# Reference magnitude for the step of a parameter that is zero.
USUAL = {"youngs_modulus_pa": 1e5, "rpe_per_bar": 0.05, "a1_per_n": 1e-2, "a2_per_n2": 1e-4, "shear_ratio": 0.4}


@dataclass(frozen=True)
class TipWrench:
    """Dead forces (K, 3) [N] and moments (K, 3) [N m] in the base frame; the force at point_m (3,) of the tip frame.

    Raises ValueError for what is not finite or of another shape.
    """

    force_n: Array
    moment_n_m: Array
    point_m: Array

    def __post_init__(self) -> None:
        for name in ("force_n", "moment_n_m", "point_m"):
            given = np.array(getattr(self, name), dtype=np.float64)
            if not np.isfinite(given).all():
                raise ValueError(f"what pulls must be finite, got {name} {given.tolist()}")
            object.__setattr__(self, name, given)
        shapes = self.force_n.shape, self.moment_n_m.shape, self.point_m.shape
        if shapes != ((len(self.force_n), 3), (len(self.force_n), 3), (3,)):
            raise ValueError(f"what pulls must have forces and moments (K, 3) at a point (3,), got shapes {shapes}")


@dataclass(frozen=True)
class Variation:
    """One neighbour of an arm: the same but for a change of size `step`, in whatever unit.

    arm: with the change in it, or as it was. pressure_pa (K, N), pull: with the change in them; None where as they
    were. The step should be about 1e-7 of what would be a large change.
    """

    step: float
    arm: Arm
    pressure_pa: Array | None = None
    pull: TipWrench | None = None


@dataclass(frozen=True)
class Gradients:
    """K tips and how they answer to P changes, per unit of each change's step.

    tip_m (K, 3), tip_rotation (K, 3, 3), ok (K,). tip_by (K, 3, P) [m]; turn_by (K, 3, P) [rad]: rotation vector in
    the base frame. NaN where there is no stable solution; unstable (K,) where an unstable equilibrium was found.
    """

    tip_m: Array
    tip_rotation: Array
    ok: NDArray[np.bool_]
    tip_by: Array
    turn_by: Array
    unstable: NDArray[np.bool_]


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
        stack = _Stack.of(arm, _varied(arm, pressure), nodes, pressure[None])
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
) -> Gradients:
    """Tips at rest for rows of pressure_pa (K, N) [Pa], and how they answer to each change, in one call on all cores.

    weight_kg (K,), pull (K rows): hang on the tip. Raises ValueError for what does not fit.
    """
    rows, nodes = _rows(arm, pressure_pa), steps_along(arm, nodes)
    _check_changes(arm, changes, rows)
    tip_loads = _tip_loads(arm, changes, len(rows), weight_kg, pull)
    stack = _Stack.of(arm, changes, nodes, rows)
    lane_rows = _lane_rows(rows, [change.pressure_pa for change in changes])
    parts: dict[int, Gradients] = {}

    def part(span: range) -> None:
        if len(span):
            at = slice(span.start, span.stop)
            room = Lanes.of(len(changes), nodes, 1)
            parts[span.start] = _solve(
                stack.own(at), lane_rows[at], tip_loads if len(tip_loads) == 1 else tip_loads[at], nodes, room
            )

    spread(part, len(rows), workers, ROWS_PER_THREAD)
    each = [parts[start] for start in sorted(parts)]
    return Gradients(
        *(np.concatenate([getattr(one, name) for one in each]) for name in ("tip_m", "tip_rotation", "ok")),
        *(np.concatenate([getattr(one, name) for one in each]) for name in ("tip_by", "turn_by", "unstable")),
    )


def motion(
    arm: Arm,
    pressure_pa: ArrayLike,
    dt_s: float,
    changes: Sequence[Variation],
    weight_kg: ArrayLike | None = None,
    every: int = 1,
    nodes: int | None = None,
    pull: TipWrench | None = None,
) -> Gradients:
    """The tip in motion, from rest under the first of the rows of pressure_pa (1 + T, N) [Pa], one time step a row.

    Answers of the first row and of `every` so many steps after it: K = 1 + T // every. weight_kg (1 + T,), pull
    (1 + T rows): hang on the tip. The scheme is BDF-alpha. Raises ValueError for what does not fit.
    """
    rows = _rows(arm, pressure_pa)
    _check_changes(arm, changes, rows)
    changes = [_with_hysteresis(change, arm, rows) for change in changes]
    rows = effective_pa(arm.actuation.stops, rows)
    if every < 1:
        raise ValueError(f"answers are asked for every so many steps, at least 1, got {every}")
    tip_loads = _tip_loads(arm, changes, len(rows), weight_kg, pull)
    count, neighbours = 1 + (len(rows) - 1) // every, len(changes)
    place, turned = np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan)
    by, good = np.full((count, neighbours, 6), np.nan), np.zeros(count, dtype=np.bool_)
    unstable = np.zeros(count, dtype=np.bool_)
    dynamics = Dynamics(arm, dt_s, nodes=nodes)
    n = dynamics.nodes
    still = _Stack.of(arm, changes, n, rows[:1])
    here = np.empty(layout.HANGS)
    apply_tip_load(still.first.cap, tip_loads[0], here)
    try:
        dynamics.begin(still.first, rows[0], here, still.load, still.loaded)
    except NotConverged as fault:
        unstable[0] = isinstance(fault, Unstable)
        return _gradients(place, turned, good, by, unstable)
    swinging = _Stack.of(arm, changes, n, rows, dynamics.c0, dt_s)
    arm_in_motion = dynamics.arm_with_cap._replace(
        stiffness=swinging.first.stiffness, rest=swinging.first.rest, per_pressure=swinging.first.per_pressure
    )
    works, branches = len(swinging.lanes.works), len(arm.material.branches)
    dynamic_sensitivities(
        swinging.first.walls, arm_in_motion, dynamics.state, still.lanes, still.first.scale, swinging.lanes,
        _lane_rows(rows, [change.pressure_pa for change in changes]), tip_loads, swinging.steps, every,
        layout.aligned(works, n + 1, (36 if branches else 24) * layout.LANES),
        layout.aligned(works, branches, n + 1, 12 * layout.LANES), dynamics.room,
        Lanes.of(neighbours, n, dynamics.segments), TOLERANCE_IN_MOTION,
        TipAnswers(place, turned, by, good, unstable),
    )  # fmt: skip
    lost = ~good
    place[lost], turned[lost], by[lost] = np.nan, np.nan, np.nan
    return _gradients(place, turned, good, by, unstable)


def _with_hysteresis(change: Variation, arm: Arm, rows: Array) -> Variation:
    """The change with the effective pressures of its arm, where these differ from the pressures."""
    stops = change.arm.actuation.stops
    if not (stops or arm.actuation.stops):
        return change
    given = rows if change.pressure_pa is None else change.pressure_pa
    return replace(change, pressure_pa=effective_pa(stops, given))


def _gradients(
    place: Array, turned: Array, good: NDArray[np.bool_], by: Array, unstable: NDArray[np.bool_]
) -> Gradients:
    answers = by.transpose(0, 2, 1)
    return Gradients(place, turned, good, answers[:, :3], answers[:, 3:], unstable)


def _rows(arm: Arm, pressure_pa: ArrayLike) -> Array:
    rows = np.array(pressure_pa, dtype=np.float64)
    actuators = arm.geometry.actuators
    if rows.ndim != 2 or rows.shape[1] != actuators or not len(rows):
        raise ValueError(f"pressure_pa must be rows of {actuators} numbers, got shape {rows.shape}")
    return rows


def _weights(weight_kg: ArrayLike | None, count: int) -> Array:
    weight = np.zeros(count) if weight_kg is None else np.array(weight_kg, dtype=np.float64)
    if weight.shape != (count,) or not np.isfinite(weight).all():
        raise ValueError(f"weight_kg must hold {count} finite numbers")
    return weight


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
    return _lane_rows(still, [still] * fields + list(PRESSURE_STEP_PA * np.eye(actuators)[:, None]))


def _lane_rows(rows: Array, changed: Sequence[Array | None]) -> Array:
    """Pressures (K, W, N, 8) by lane from those of the arm (K, N) and of its neighbours."""
    works = passes(len(changed))
    out = np.empty((works * layout.LANES, *rows.shape))
    out[:] = rows
    for lane, own in enumerate(changed, start=FIRST):
        if own is not None:
            out[lane] = own
    split = out.reshape(works, layout.LANES, *rows.shape)
    return np.ascontiguousarray(split.transpose(2, 0, 3, 1))


def _lanes(order: NDArray[np.intp], values: Sequence[ArrayLike]) -> Array:
    """One value each of the arm and its neighbours, (W, .., 8) by lane."""
    each = np.array(values, dtype=np.float64)[order].reshape(-1, layout.LANES, *np.shape(values[0]))
    return np.ascontiguousarray(np.moveaxis(each, 1, -1))


def _tip_loads(
    arm: Arm, changes: Sequence[Variation], count: int, weight_kg: ArrayLike | None, pull: TipWrench | None
) -> Array:
    """What hangs on the lanes' tips beyond the cap, (count, W, 12, 8) for `apply_pressure`; or one empty row."""
    weight = _weights(weight_kg, count)
    if pull is None and any(change.pull is not None for change in changes):
        raise ValueError("what pulls may only change where something pulls")
    for some in (pull, *(change.pull for change in changes)):
        if some is not None and len(some.force_n) != count:
            raise ValueError(f"what pulls has {len(some.force_n)} rows, the pressures {count}")
    lanes = passes(len(changes)) * layout.LANES
    tip_loads = np.zeros((lanes, count if pull is not None or weight.any() else 1, 12))
    own = [(arm, pull)] * lanes
    own[FIRST : FIRST + len(changes)] = [(change.arm, change.pull or pull) for change in changes]
    for lane, (one, pulls) in zip(tip_loads, own, strict=True):
        if weight.any():
            lane[:, :3] = weight[:, None] * np.asarray(one.gravity_m_s2)
        if pulls is not None:
            lane[:, :3] += pulls.force_n
            lane[:, 3:6], lane[:, 6:9], lane[:, 9:] = pulls.moment_n_m, pulls.force_n, pulls.point_m
    return np.ascontiguousarray(tip_loads.reshape(-1, layout.LANES, *tip_loads.shape[1:]).transpose(2, 0, 3, 1))


@dataclass(frozen=True)
class _Stack:
    """The arm and its neighbours as the kernels take them; one section for each row of pressures, or one for all."""

    first: KernelArguments
    lanes: LaneArguments
    load: Array
    loaded: bool
    work: Array
    steps: Array

    @classmethod
    def of(
        cls, arm: Arm, changes: Sequence[Variation], nodes: int, rows: Array, c0: float = 0.0, dt_s: float = 0.0
    ) -> _Stack:
        """Of rows of pressures (K, N), the first ones or all; they matter only to rules that freeze the moduli."""
        arms, some = [arm, *(change.arm for change in changes)], len(rows)
        pressure = [rows, *(rows if change.pressure_pa is None else change.pressure_pa[:some] for change in changes)]
        each = [KernelArguments.of(one, own, c0, dt_s) for one, own in zip(arms, pressure, strict=True)]
        first = each[0]
        order = np.zeros(passes(len(changes)) * layout.LANES, dtype=np.intp)
        order[FIRST : FIRST + len(changes)] = np.arange(1, len(arms))
        works = layout.aligned(len(order) // layout.LANES, len(first.prepared) // layout.LANES, layout.LANES)
        works[:] = _lanes(order, [p.prepared[:: layout.LANES] for p in each])
        weight = [one.line_density_kg_m * one.rod_weight * np.asarray(one.gravity_m_s2) for one in arms]
        heavier = [own - weight[0] for own in weight]
        works[:, layout.STRIDE] = _lanes(order, [p.length_m / nodes for p in each])
        works[:, layout.WEIGHT : layout.WEIGHT + 3] = _lanes(order, heavier)
        works[:, layout.CENTRE : layout.CENTRE + 2] = _lanes(order, [p.centre_m for p in each])
        ends = _lanes(order, [p.cap for p in each])
        load, loaded = first.load(arm, None, nodes)
        sections = [p.stiffness for p in each], [p.rest for p in each], [p.per_pressure for p in each]
        stiffness, rest, per_pressure = (np.ascontiguousarray(_lanes(order, part).swapaxes(0, 1)) for part in sections)
        lanes = LaneArguments(
            works.reshape(len(works), -1), stiffness, rest, per_pressure, _lanes(order, [p.free_per_pa for p in each]),
            ends, loaded or bool(np.any(heavier)), any(one.cap_inertia and one.inertia for one in arms),
            _lanes(order, [branch_factors(one.material, c0, dt_s) for one in arms]),
        )  # fmt: skip
        steps = np.array([change.step for change in changes], dtype=np.float64)
        return cls(first, lanes, load, loaded, first.work(), steps)

    def own(self, rows: slice) -> _Stack:
        """The part for some rows, with work arrays of its own."""
        lanes, first = self.lanes, self.first
        works = layout.aligned(*lanes.works.shape)
        works[:] = lanes.works
        at = slice(None) if len(lanes.stiffness) == 1 else rows
        at_rest = slice(None) if len(lanes.rest) == 1 else rows
        own = lanes._replace(
            works=works, stiffness=lanes.stiffness[at], rest=lanes.rest[at_rest], per_pressure=lanes.per_pressure[at]
        )
        first = replace(
            first, stiffness=first.stiffness[at], rest=first.rest[at_rest], per_pressure=first.per_pressure[at]
        )
        return replace(self, first=first, lanes=own, work=first.work())


class _Kept(threading.local):
    """What `tip_gradient` works in, made once per thread: its arrays are written to."""

    def __init__(self) -> None:
        self.stack = lru_cache(maxsize=64)(_stack_of_material)
        self.lanes = lru_cache(maxsize=8)(_lanes_at_rest)


def _stack_of_material(arm: Arm, nodes: int) -> _Stack:
    nothing = np.zeros(arm.geometry.actuators)
    return _Stack.of(arm, _varied(arm, nothing), nodes, nothing[None])


def _lanes_at_rest(neighbours: int, nodes: int) -> Lanes:
    return Lanes.of(neighbours, nodes, 1)


_kept = _Kept()


def _solve(stack: _Stack, rows: Array, tip_loads: Array, nodes: int, room: Lanes) -> Gradients:
    """For pressures (K, W, N, 8); the stack's work arrays are written to."""
    count, first, neighbours = len(rows), stack.first, len(stack.steps)
    place, turned, by = np.empty((count, 3)), np.empty((count, 3, 3)), np.empty((count, neighbours, 6))
    good, unstable = np.empty(count, dtype=np.bool_), np.empty(count, dtype=np.bool_)
    arm = first.arm(stack.work, first.cap, stack.load, stack.loaded)
    answers = TipAnswers(place, turned, by, good, unstable)
    static_sensitivities(
        first.walls,
        arm,
        stack.lanes,
        rows,
        tip_loads,
        stack.steps,
        workspace_for(nodes),
        room,
        TOLERANCE_AT_REST,
        answers,
    )
    return _gradients(place, turned, good, by, unstable)
