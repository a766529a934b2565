"""How the tip answers to whatever may change a little: exact gradients, for identification.

By the implicit function theorem (model/neighbours.py): neighbours of a solved arm are integrated beside it, no further
Newton iterations.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model import layout
from model.batch import spread
from model.errors import NotConverged
from model.lanes import FIRST, Lanes, passes
from model.loads import Loads
from model.moving import moving
from model.problem import SOLVED, Problem, pressures
from model.resting import resting
from model.shooting import room_for

if TYPE_CHECKING:
    from model.arm import Arm

Array = NDArray[np.float64]

LINEAR_PARAMETERS = ("youngs_modulus_pa", "rpe_per_bar", "shear_ratio")
EQ_32_PARAMETERS = ("a1_per_n", "a2_per_n2", "rpe_per_bar", "shear_ratio")
STEP = 1e-7
PRESSURE_STEP_PA = 0.01
# What a step is a share of where the parameter itself is zero.
USUAL = {"youngs_modulus_pa": 1e5, "rpe_per_bar": 0.05, "a1_per_n": 1e-2, "a2_per_n2": 1e-4, "shear_ratio": 0.4}


@dataclass(frozen=True)
class Pull:
    """Dead forces (K, 3) [N] and moments (K, 3) [N m] in the base frame; the force at point_m (3,) of the tip frame."""

    force_n: Array
    moment_n_m: Array
    point_m: Array


@dataclass(frozen=True)
class Change:
    """One neighbour of an arm: the same but for a change of size `step`, in whatever unit.

    arm: with the change in it, or as it was. pressure_pa (K, N), pull: with the change in them; None where as they
    were. The step should be about 1e-7 of what would be a large change.
    """

    step: float
    arm: Arm
    pressure_pa: Array | None = None
    pull: Pull | None = None


@dataclass(frozen=True)
class Gradients:
    """K tips and how they answer to P changes, per unit of each change's step.

    tip_m (K, 3), tip_rotation (K, 3, 3), ok (K,). tip_by (K, 3, P) [m]; turn_by (K, 3, P) [rad]: rotation vector in
    the base frame. NaN where there is no solution.
    """

    tip_m: Array
    tip_rotation: Array
    ok: NDArray[np.bool_]
    tip_by: Array
    turn_by: Array


@dataclass(frozen=True)
class TipGradient:
    """tip_m (3,); by_parameter: material field -> d tip / d field (3,), per its unit; by_pressure (3, N) [m/Pa]."""

    tip_m: Array
    by_parameter: dict[str, Array]
    by_pressure: Array


def tip_gradient(arm: Arm, pressure_pa: ArrayLike, loads: Loads | None = None, nodes: int = 20) -> TipGradient:
    """The tip at rest and its gradient by the section's material and the pressures. Raises as `Arm.statics` does."""
    pressure = pressures(arm, pressure_pa)
    _check_nodes(nodes)
    names = _material(arm)
    stack = _Stack.of(arm, _varied(arm, pressure), nodes, pressure[None]) if _frozen(arm) else _kept.stack(arm, nodes)
    tips = stack.bare
    if loads is not None:
        load, loaded = stack.first.load(arm, loads, nodes)
        # What is kept must not remember a load.
        stack = replace(stack.at(slice(None)), load=load, loaded=loaded, loaded_lanes=loaded or stack.loaded_lanes)
        tips = replace(tips, hung=tips.hung + loads.tip()[:, None])
    rows = pressure[:, None] + _shifts(len(names), len(pressure))
    found = _solve(stack, rows, tips, nodes, _kept.lanes(len(stack.steps), nodes))
    if not found.ok[0]:
        bar = ", ".join(f"{value / 1e5:.4g}" for value in pressure)
        raise NotConverged(f"no equilibrium found at {bar} bar: a pressure or load may be far outside the arm's range")
    by = found.tip_by[0]
    return TipGradient(found.tip_m[0], dict(zip(names, by.T, strict=False)), by[:, len(names) :])


def statics(
    arm: Arm,
    pressure_pa: ArrayLike,
    changes: Sequence[Change] = (),
    weight_kg: ArrayLike | None = None,
    pull: Pull | None = None,
    nodes: int = 20,
    workers: int | None = None,
) -> Gradients:
    """Tips at rest for rows of pressure_pa (K, N) [Pa], and how they answer to each change, in one call on all cores.

    weight_kg (K,): hangs on the tip. Raises ValueError for what does not fit.
    """
    rows = _rows(arm, pressure_pa)
    _check_nodes(nodes)
    _check_changes(arm, changes, rows)
    tips = _Tips.of(arm, changes, len(rows), weight_kg, pull)
    stack = _Stack.of(arm, changes, nodes, rows)
    lane_rows = _lane_rows(rows, [change.pressure_pa for change in changes])
    parts: dict[int, Gradients] = {}

    def part(span: range) -> None:
        if len(span):
            at = slice(span.start, span.stop)
            room = Lanes.of(len(changes), nodes, 1)
            parts[span.start] = _solve(stack.at(at), lane_rows[at], tips.at(at), nodes, room)

    spread(part, len(rows), workers)
    each = [parts[start] for start in sorted(parts)]
    return Gradients(
        *(np.concatenate([getattr(one, name) for one in each]) for name in ("tip_m", "tip_rotation", "ok")),
        *(np.concatenate([getattr(one, name) for one in each]) for name in ("tip_by", "turn_by")),
    )


def motion(
    arm: Arm,
    pressure_pa: ArrayLike,
    dt_s: float,
    changes: Sequence[Change],
    weight_kg: ArrayLike | None = None,
    every: int = 1,
    nodes: int | None = None,
) -> Gradients:
    """The tip in motion, from rest under the first of the rows of pressure_pa (1 + T, N) [Pa], one time step a row.

    Answers of the first row and of `every` so many steps after it: K = 1 + T // every. weight_kg (1 + T,): hangs on the
    tip. The scheme is BDF-alpha. Raises ValueError for frozen moduli and for what does not fit.
    """
    rows = _rows(arm, pressure_pa)
    _check_changes(arm, changes, rows)
    if _frozen(arm) or any(change.pull is not None for change in changes):
        raise ValueError("a motion has gradients with modulus_rule 'pointwise' or a homogeneous variant, and no pull")
    weight = _weights(weight_kg, len(rows))
    count = 1 + (len(rows) - 1) // every
    neighbours = len(changes)
    place, turned = np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan)
    by, good = np.full((count, neighbours, 6), np.nan), np.zeros(count, dtype=np.bool_)
    hung = weight[:, None] * np.asarray(arm.gravity_m_s2)
    dynamics = arm.dynamics(dt_s, nodes=nodes)
    try:
        dynamics.start(rows[0], Loads(tip_force_n=hung[0]))
    except NotConverged:
        return _gradients(place, turned, good, by)
    n = dynamics.nodes
    still = _Stack.of(arm, changes, n, rows)
    swinging = _Stack.of(arm, changes, n, rows, dynamics.c0)
    moving(
        *dynamics.arguments(), swinging.tip, still.works[0], still.rests[0], still.per_pressures[0],
        still.first.scale, swinging.works[0], swinging.rests[0], swinging.per_pressures[0], swinging.frees[0],
        swinging.ends, _lane_rows(rows, [change.pressure_pa for change in changes]), hung,
        swinging.loaded_lanes, swinging.heavy, layout.aligned(len(swinging.ends), n + 1, 24 * layout.LANES),
        Lanes.of(neighbours, n, dynamics.segments), swinging.steps, every, place, turned, by, good,
    )  # fmt: skip
    lost = ~good
    place[lost], turned[lost], by[lost] = np.nan, np.nan, np.nan
    return _gradients(place, turned, good, by)


def _gradients(place: Array, turned: Array, good: NDArray[np.bool_], by: Array) -> Gradients:
    answers = by.transpose(0, 2, 1)
    return Gradients(place, turned, good, answers[:, :3], answers[:, 3:])


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


def _check_nodes(nodes: int) -> None:
    if nodes < 2:
        raise ValueError(f"an arm needs at least two steps along it, got {nodes}")


def _check_changes(arm: Arm, changes: Sequence[Change], rows: Array) -> None:
    if not np.isfinite(rows).all():
        raise ValueError("pressures must be finite")
    for change in changes:
        if change.arm.section_rule != arm.section_rule or change.arm.geometry.actuators != arm.geometry.actuators:
            raise ValueError("a change must keep the number of actuators and the section rule")
        if not (np.isfinite(change.step) and change.step != 0):
            raise ValueError(f"a change needs a step that is not zero, got {change.step}")
        if change.pressure_pa is not None and change.pressure_pa.shape != rows.shape:
            raise ValueError(f"a change has pressures of shape {change.pressure_pa.shape}, the arm {rows.shape}")


def _frozen(arm: Arm) -> bool:
    """Whether the moduli are those of the pressures, so that every row of pressures has its own section."""
    return arm.section_rule not in ("linear", "pointwise")


def _material(arm: Arm) -> tuple[str, ...]:
    """The material's fields that the section rests on."""
    return LINEAR_PARAMETERS if arm.section_rule == "linear" else EQ_32_PARAMETERS


def _varied(arm: Arm, pressure: Array) -> list[Change]:
    """Changes of these fields and then of each pressure (N,)."""
    changes = []
    for name in _material(arm):
        value = getattr(arm.material, name)
        # A parameter that is zero, such as no effect of the radial pressure, moves by a share of what is usual.
        step = STEP * abs(value) or STEP * USUAL[name]
        changes.append(Change(step, replace(arm, material=replace(arm.material, **{name: value + step}))))
    pressed = pressure + PRESSURE_STEP_PA * np.eye(len(pressure))
    return changes + [Change(PRESSURE_STEP_PA, arm, own[None]) for own in pressed]


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


@dataclass(frozen=True)
class _Tips:
    """What hangs on the tip beyond the cap, as `lanes.press` takes it: rows of (W, 6, 8), one for all where alike."""

    hung: Array
    pull: Array

    @classmethod
    def of(
        cls, arm: Arm, changes: Sequence[Change], count: int, weight_kg: ArrayLike | None, pull: Pull | None
    ) -> _Tips:
        works = passes(len(changes))
        shape = (works, 6, layout.LANES)
        weight = _weights(weight_kg, count)
        if pull is None:
            if any(change.pull is not None for change in changes):
                raise ValueError("what pulls may only change where something pulls")
            hung = np.zeros((count if weight.any() else 1, *shape))
            if weight.any():
                hung[:, :, :3] = (weight[:, None] * np.asarray(arm.gravity_m_s2))[:, None, :, None]
            return cls(hung, np.zeros((1, *shape)))
        hung, pulls = np.zeros((count, works * layout.LANES, 6)), np.zeros((count, works * layout.LANES, 6))
        own = [pull] * FIRST + [change.pull or pull for change in changes]
        own += [pull] * (works * layout.LANES - len(own))
        for lane, one in enumerate(own):
            hung[:, lane, :3], hung[:, lane, 3:] = one.force_n, one.moment_n_m
            pulls[:, lane, :3], pulls[:, lane, 3:] = one.force_n, one.point_m
        hung[:, :, :3] += (weight[:, None] * np.asarray(arm.gravity_m_s2))[:, None]
        hung, pulls = (
            np.ascontiguousarray(a.reshape(count, works, layout.LANES, 6).transpose(0, 1, 3, 2)) for a in (hung, pulls)
        )
        if not (np.isfinite(hung).all() and np.isfinite(pulls).all()):
            raise ValueError("what pulls must be finite")
        return cls(hung, pulls)

    def at(self, rows: slice) -> _Tips:
        return _Tips(*(a if len(a) == 1 else a[rows] for a in (self.hung, self.pull)))


@dataclass(frozen=True)
class _Stack:
    """The arm and its neighbours as the kernels take them: `first` and the arrays (R, ..) of `resting.resting`."""

    first: Problem
    work: Array
    rest: Array
    per_pressure: Array
    free: Array
    works: Array
    rests: Array
    per_pressures: Array
    frees: Array
    ends: Array
    load: Array
    loaded: bool
    loaded_lanes: bool
    heavy: bool
    tip: Array
    steps: Array
    bare: _Tips

    @classmethod
    def of(cls, arm: Arm, changes: Sequence[Change], nodes: int, rows: Array, c0: float = 0.0) -> _Stack:
        """Of rows of pressures (K, N), which matter only to rules that freeze the moduli."""
        arms = [arm, *(change.arm for change in changes)]
        pressure = [rows, *(rows if change.pressure_pa is None else change.pressure_pa for change in changes)]
        count = len(rows) if _frozen(arm) else 1
        each = [[Problem.of(one, own[r], c0) for one, own in zip(arms, pressure, strict=True)] for r in range(count)]
        firsts = each[0]
        first = firsts[0]
        order = np.zeros(passes(len(changes)) * layout.LANES, dtype=np.intp)
        order[FIRST : FIRST + len(changes)] = np.arange(1, len(arms))
        works = layout.aligned(count, len(order) // layout.LANES, len(first.work) // layout.LANES, layout.LANES)
        for r, problems in enumerate(each):
            works[r] = _lanes(order, [p.work[:: layout.LANES] for p in problems])
        gravity = np.asarray(arm.gravity_m_s2)
        heavier = [
            (one.line_density_kg_m - arm.line_density_kg_m) * gravity if arm.rod_weight else np.zeros(3) for one in arms
        ]
        works[:, :, layout.STRIDE] = _lanes(order, [p.length_m / nodes for p in firsts])
        works[:, :, layout.WEIGHT : layout.WEIGHT + 3] = _lanes(order, heavier)
        works[:, :, layout.CENTRE : layout.CENTRE + 2] = _lanes(order, [p.centre_m for p in firsts])
        ends = _lanes(order, [p.tip(one, None) for p, one in zip(firsts, arms, strict=True)])
        works[:, :, layout.END : layout.END + 13] = ends
        load, loaded = first.load(arm, None, nodes)
        return cls(
            first,
            np.array([problems[0].work for problems in each]).reshape(count, -1),
            np.array([problems[0].rest for problems in each]).reshape(count, 6),
            np.array([problems[0].per_pressure for problems in each]).reshape(count, 6, -1),
            np.array([problems[0].free_per_pa for problems in each]),
            works.reshape(count, len(order) // layout.LANES, -1),
            np.array([_lanes(order, [p.rest for p in problems]) for problems in each]),
            np.array([_lanes(order, [p.per_pressure for p in problems]) for problems in each]),
            np.array([_lanes(order, [p.free_per_pa for p in problems]) for problems in each]),
            ends,
            load,
            loaded,
            loaded or bool(np.any(heavier)),
            arm.cap_inertia,
            first.tip(arm, None),
            np.array([change.step for change in changes], dtype=np.float64),
            _Tips(*np.zeros((2, 1, works.shape[1], 6, layout.LANES))),
        )

    def at(self, rows: slice) -> _Stack:
        """The part for some rows, with work arrays of its own."""
        chosen = slice(None) if len(self.work) == 1 else rows
        works = layout.aligned(*self.works[chosen].shape)
        works[:] = self.works[chosen]
        work = layout.aligned(*self.work[chosen].shape)
        work[:] = self.work[chosen]
        return replace(
            self, work=work, works=works, rest=self.rest[chosen], per_pressure=self.per_pressure[chosen],
            free=self.free[chosen], rests=self.rests[chosen], per_pressures=self.per_pressures[chosen],
            frees=self.frees[chosen],
        )  # fmt: skip


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


def _solve(stack: _Stack, rows: Array, tips: _Tips, nodes: int, room: Lanes) -> Gradients:
    """For pressures (K, W, N, 8); the stack's work arrays are written to."""
    count, first, neighbours = len(rows), stack.first, len(stack.steps)
    place, turned, by = np.empty((count, 3)), np.empty((count, 3, 3)), np.empty((count, neighbours, 6))
    good = np.empty(count, dtype=np.bool_)
    resting(
        stack.work, stack.works, first.law, first.actuators, stack.rest, stack.per_pressure, stack.free, stack.rests,
        stack.per_pressures, stack.frees, stack.ends, rows, tips.hung, tips.pull, stack.load, stack.loaded,
        stack.loaded_lanes, stack.heavy, stack.tip, first.length_m, first.scale, first.centre_m, SOLVED,
        room_for(nodes), room, stack.steps, place, turned, by, good,
    )  # fmt: skip
    return _gradients(place, turned, good, by)
