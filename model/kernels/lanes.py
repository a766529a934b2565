"""Kernels for arms that differ a little, one in each lane: what they work in, and their way from base to tip.

A lane has its own length, section, pressures, loads and past. Lanes are counted through all work arrays: 0 is the arm,
1 to 6 move a base strain each, the neighbours follow.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from model.kernels.between_nodes import Quaternion, orientation_between, passed_between
from model.kernels.law import Walls, branched
from model.kernels.layout import (
    AXIAL,
    CENTRE,
    END,
    FOURTH,
    GATHER,
    HANGS,
    LANES,
    MORE,
    NODE,
    OFFSET,
    PAST,
    PER_TUBE,
    PULL,
    SLOPE,
    STAGE,
    STATE,
    STRIDE,
    THIRD,
    TRIO,
    aligned,
)
from model.kernels.rod import stage
from model.kernels.vec3 import Triple, called, cross, inlined, leaf, plus, put, rotation, triple

Array = Any

FIRST = 7  # lane of the first neighbour
OWN = ((0.0, 0.0, 0.0),) * 8  # in the place of a history that lanes share


class Lanes(NamedTuple):
    """The arrays that the lanes work in."""

    states: Array  # (2, W, N + 1, 128) of every work array, now and a time step before
    derivatives: Array  # the same of their slopes
    directions: Array  # (S, 6, 16), per segment
    triangle: Array  # (S, 6, 6)
    along: Array  # (S, P, 6), per segment and neighbour
    parts: Array  # (P, 16), by what each neighbour differs at a segment's start
    shares: Array  # (S, W, 6, 8), of the moved base strains in each lane
    matrix: Array  # (6, 6)
    right: Array  # (P, 6)
    place: Array  # (W, 6, 8), tip and turn of every lane

    @classmethod
    def of(cls, neighbours: int, n: int, segments: int) -> Lanes:
        """Room for so many neighbours on n steps along the arm."""
        works = passes(neighbours)
        size = 2, works, n + 1, STATE * LANES
        return cls(
            aligned(*size), aligned(*size), aligned(segments, 6, STATE), aligned(segments, 6, 6),
            aligned(segments, neighbours, 6), aligned(neighbours, STATE),
            aligned(segments, works, 6, LANES), aligned(6, 6), aligned(neighbours, 6), aligned(works, 6, LANES),
        )  # fmt: skip


def passes(neighbours: int) -> int:
    """Work arrays, and so passes, for so many neighbours."""
    return -(-(FIRST + neighbours) // LANES)


@inlined
def _recall(w: Array, walls: Walls, past: Array) -> None:
    """The history at a node, and the walls' past strains."""
    for i in range(12 * LANES):
        w[PAST * LANES + i] = past[i]
    slope = 30 * LANES if branched(walls.law) else 12 * LANES
    for i in range(6 * LANES):
        w[(PAST + 12) * LANES + i] = past[slope + i]
    if branched(walls.law):
        for i in range(6 * LANES):
            w[(PAST + 18) * LANES + i] = past[24 * LANES + i]


@inlined
def _recall_between(w: Array, walls: Walls, a: Array, b: Array) -> None:
    """The same half-way between two nodes, as `time_stepping.between` finds it."""
    for c in range(12):
        for i in range(LANES):
            at, to = c * LANES + i, (12 + c) * LANES + i
            bent = 0.125 * w[STRIDE * LANES + i] * (a[to] - b[to])
            w[PAST * LANES + at] = 0.5 * (a[at] + b[at]) + bent
    own, slope = (24, 30) if branched(walls.law) else (0, 12)
    for c in range(6):
        for i in range(LANES):
            at, to, k = (own + c) * LANES + i, (slope + c) * LANES + i, (12 + c) * LANES + i
            w[PAST * LANES + k] = 1.5 / w[STRIDE * LANES + i] * (b[at] - a[at]) - 0.25 * (a[to] + b[to])
    if branched(walls.law):
        for c in range(6):
            for i in range(LANES):
                at, to = (24 + c) * LANES + i, (30 + c) * LANES + i
                bent = 0.125 * w[STRIDE * LANES + i] * (a[to] - b[to])
                w[(PAST + 18 + c) * LANES + i] = 0.5 * (a[at] + b[at]) + bent


@leaf
def integrate_lanes(
    w: Array, walls: Walls, past: Array, moving: bool, load: Array, loaded: bool, first: int, last: int,
    states: Array, derivatives: Array,
) -> None:  # fmt: skip
    """Integrate the node's state, all lanes, from node `first` to node `last`, as `rod.integrate` does.

    past (N + 1, 192): history of velocities, strains and all their slopes at the nodes, of every lane, looked at when
    `moving`; where the walls have branches (N + 1, 288), with their past strains and the slopes of these.
    """
    size, n = STATE * LANES, states.shape[0] - 1
    for j in range(first, last + 1):
        if j == last and last < n:
            break
        for i in range(size):
            states[j, i] = w[NODE * LANES + i]
        if moving:
            _recall(w, walls, past[j])
        stage(w, walls, OWN, True, load, loaded, 2 * j, NODE, STAGE, 0.5)
        for i in range(12 * LANES):
            derivatives[j, i] = w[SLOPE * LANES + i]
        if j == n:
            break
        if moving:
            _recall_between(w, walls, past[j], past[j + 1])
        stage(w, walls, OWN, True, load, loaded, 2 * j + 1, STAGE, THIRD, 0.5)
        stage(w, walls, OWN, True, load, loaded, 2 * j + 1, THIRD, FOURTH, 1.0)
        if moving:
            _recall(w, walls, past[j + 1])
        stage(w, walls, OWN, True, load, loaded, 2 * j + 2, FOURTH, NODE, 1.0 / 6.0)


@leaf
def apply_pressure(
    works: Array, actuators: int, stiffness: Array, rest: Array, per_pressure: Array, free: Array, ends: Array,
    pressure: Array, tip_loads: Array,
) -> None:  # fmt: skip
    """Write sections, pressures (W, N, 8) and loads at the tip into the work arrays (W, size), lane by lane.

    stiffness (W, 24, 8), rest (W, 6, 8), per_pressure (W, 6, N, 8), free (W, 8) and ends (W, 19, 8): as of
    `KernelArguments`. tip_loads (W, 12, 8): force and moment beyond that, a part of the force that pulls elsewhere, and
    where.
    """
    first = TRIO if actuators <= 3 else MORE
    for p in range(works.shape[0]):
        w = works[p]
        for c in range(24):
            for i in range(LANES):
                w[(AXIAL + c) * LANES + i] = stiffness[p, c, i]
        for c in range(6):
            for i in range(LANES):
                total = rest[p, c, i]
                for k in range(actuators):
                    total += per_pressure[p, c, k, i] * pressure[p, k, i]
                w[(OFFSET + c) * LANES + i] = total
        for c in range(HANGS):
            for i in range(LANES):
                w[(END + c) * LANES + i] = ends[p, c, i]
        for c in range(6):
            for i in range(LANES):
                w[(END + c) * LANES + i] += tip_loads[p, c, i]
                w[(PULL + c) * LANES + i] += tip_loads[p, 6 + c, i]
        for k in range(actuators):
            for i in range(LANES):
                w[(first + PER_TUBE * k + 2) * LANES + i] = free[p, i] * pressure[p, k, i]


@called
def apply_tip_load(tip: Array, tip_loads: Array, here: Array) -> None:
    """Tip load (19,) of the arm itself, with the load that `apply_pressure` adds."""
    for c in range(HANGS):
        here[c] = tip[c]
    for c in range(6):
        here[c] += tip_loads[0, c, 0]
        here[HANGS - 6 + c] += tip_loads[0, 6 + c, 0]


@inlined
def _gather(w: Array, states: Array, derivatives: Array, last: int) -> None:
    """The way from the base to node `last` in every lane, as `axis.axis` finds it, and the slopes p' and p'' there.

    They stand at GATHER, the node's state at NODE.
    """
    for i in range(9 * LANES):
        w[GATHER * LANES + i] = 0.0
    for j in range(last + 1):
        for i in range(STATE * LANES):
            w[NODE * LANES + i] = states[j, i]
        for i in range(6 * LANES):
            w[SLOPE * LANES + i] = derivatives[j, i]
        for i in range(LANES):
            at, was, turned = triple(w, GATHER, i), triple(w, GATHER + 3, i), triple(w, GATHER + 6, i)
            speed, turn = _slopes(w, i)
            h = w[STRIDE * LANES + i] if j > 0 else 0.0
            at = plus(plus(at, 0.5 * h, plus(was, 1.0, speed)), h * h / 12.0, plus(turned, -1.0, turn))
            put(w, GATHER, i, at)
            put(w, GATHER + 3, i, speed)
            put(w, GATHER + 6, i, turn)


@inlined
def _slopes(w: Array, i: int) -> tuple[Triple, Triple]:
    """Slopes p' and p'' of the line in lane i, by the node's state and its slopes."""
    d1, d2, d3 = rotation(_orientation(w, i))
    strain = triple(w, NODE, i)
    g = plus(triple(w, SLOPE, i), 1.0, cross(triple(w, NODE + 3, i), strain))
    speed = plus(plus((strain[0] * d1[0], strain[0] * d1[1], strain[0] * d1[2]), strain[1], d2), strain[2], d3)
    return speed, plus(plus((g[0] * d1[0], g[0] * d1[1], g[0] * d1[2]), g[1], d2), g[2], d3)


@inlined
def _orientation(w: Array, i: int) -> Quaternion:
    q = (NODE + 12) * LANES + i
    return w[q], w[q + LANES], w[q + 2 * LANES], w[q + 3 * LANES]


@inlined
def _write_place(w: Array, i: int, at: Triple, own: Quaternion, other: Quaternion, place: Array) -> None:
    """Place of lane i, moved from the centroid to the axis, and its turn against the orientation `other`."""
    d1, d2, _ = rotation(own)
    cx, cy = w[CENTRE * LANES + i], w[(CENTRE + 1) * LANES + i]
    moved = plus(plus(at, -cx, d1), -cy, d2)
    place[0, i], place[1, i], place[2, i] = moved[0] + cx, moved[1] + cy, moved[2]
    a, b, c, e = own
    a0, b0, c0, e0 = other
    over = 2.0 / (a0 * a0 + b0 * b0 + c0 * c0 + e0 * e0)
    place[3, i] = over * (-a * b0 + b * a0 - c * e0 + e * c0)
    place[4, i] = over * (-a * c0 + c * a0 - e * b0 + b * e0)
    place[5, i] = over * (-a * e0 + e * a0 - b * c0 + c * b0)


@leaf
def places(w: Array, states: Array, derivatives: Array, tip: Array, place: Array) -> None:
    """Tip (3) and turn (3) of every lane into place (6, 8), as `axis.axis` finds the tip.

    The turn is the rotation vector [rad] in the base frame by which a lane's tip is turned against the state `tip`
    (16,), to first order.
    """
    _gather(w, states, derivatives, states.shape[0] - 1)
    for i in range(LANES):
        _write_place(w, i, triple(w, GATHER, i), _orientation(w, i), (tip[12], tip[13], tip[14], tip[15]), place)


@leaf
def section_places(
    w: Array, states: Array, derivatives: Array, at: float, length: float, x: Array, place: Array
) -> None:
    """The same of the section at arc length `at` of every lane, against that of the arm x (2 N + 2, 16) of a length.

    Every lane is interpolated between the same two nodes; where they stand depends on the length of its arm.
    """
    n = states.shape[0] - 1
    last = min(max(int(at * n / length), 0), n - 1)
    h = length / n
    other = orientation_between(
        (x[last, 12], x[last, 13], x[last, 14], x[last, 15]), (x[last, 3], x[last, 4], x[last, 5]),
        (x[last + 1, 12], x[last + 1, 13], x[last + 1, 14], x[last + 1, 15]),
        (x[last + 1, 3], x[last + 1, 4], x[last + 1, 5]), at / h - last, h,
    )  # fmt: skip
    _gather(w, states, derivatives, last)
    for i in range(STATE * LANES):
        w[THIRD * LANES + i] = w[NODE * LANES + i]
        w[NODE * LANES + i] = states[last + 1, i]
    for i in range(6 * LANES):
        w[SLOPE * LANES + i] = derivatives[last + 1, i]
    for i in range(LANES):
        h = w[STRIDE * LANES + i]
        t = at / h - last
        speed, bend = _slopes(w, i)
        step = passed_between(triple(w, GATHER + 3, i), triple(w, GATHER + 6, i), speed, bend, t, h)
        q = (THIRD + 12) * LANES + i
        before = w[q], w[q + LANES], w[q + 2 * LANES], w[q + 3 * LANES]
        own = orientation_between(before, triple(w, THIRD + 3, i), _orientation(w, i), triple(w, NODE + 3, i), t, h)
        _write_place(w, i, plus(triple(w, GATHER, i), 1.0, step), own, other, place)
