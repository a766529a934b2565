"""Integration of a rod along the arc length by RK4, through its segments, in all lanes side by side."""

from __future__ import annotations

from typing import Any

from model.kernels.arguments import Rod, segment_at
from model.kernels.joints import cross_joint, end_wrench, has_inertia
from model.kernels.law import Walls, branched
from model.kernels.layout import FOURTH, LANES, NODE, PAST, SLOPE, STAGE, STATE, STEP_LENGTH, THIRD
from model.kernels.rod import past_of, stage
from model.kernels.vec3 import inlined, leaf

Array = Any

UNUSED_HISTORY = ((0.0, 0.0, 0.0),) * 8  # argument in place of a history that all lanes share


@leaf
def integrate(
    rod: Rod, history: Array, walls_past: Array, first: int, last: int, states: Array, derivatives: Array, x: Array
) -> None:
    """Integrate the state at NODE in all lanes from node `first` to node `last`, one step of RK4 or joint at a time.

    history, walls_past: as of `time_stepping.advance`. x (2 N + 2, 16): states near the solution, for the joints.
    states, derivatives: (N + 1, 128), filled at each node but `last`; at the tip also at that. Of the derivatives, the
    first twelve quantities are filled.
    """
    walls, line = rod.walls, rod.line
    n, size = states.shape[0] - 1, STATE * states.shape[0]
    if not branched(walls.law):
        walls_past = history
    k = segment_at(line, first)
    w = rod.work[k]
    for j in range(first, last + 1):
        if j == last and last < n:
            break
        for i in range(STATE * LANES):
            states[j, i] = w[NODE * LANES + i]
        at = STATE * j
        past = past_of(history, walls_past, size, at)
        stage(rod, w, past, False, 2 * j, NODE, STAGE, 0.5)
        for i in range(12 * LANES):
            derivatives[j, i] = w[SLOPE * LANES + i]
        if j == n:
            break
        if j + 1 == line.first[k + 1]:
            end_wrench(w, walls, past, False, has_inertia(rod.ends[k]))
            past = past_of(history, walls_past, size, at + STATE)
            cross_joint(w, rod.work[k + 1], walls, past, False, x[j + 1], rod.scale)
            k += 1
            w = rod.work[k]
            continue
        past = past_of(history, walls_past, size, 2 * size + at)
        stage(rod, w, past, False, 2 * j + 1, STAGE, THIRD, 0.5)
        stage(rod, w, past, False, 2 * j + 1, THIRD, FOURTH, 1.0)
        past = past_of(history, walls_past, size, at + STATE)
        stage(rod, w, past, False, 2 * j + 2, FOURTH, NODE, 1.0 / 6.0)


@inlined
def _load_history(w: Array, walls: Walls, past: Array) -> None:
    """Load the history at a node, and the past strains of the walls, into the work array."""
    for i in range(12 * LANES):
        w[PAST * LANES + i] = past[i]
    slope = 30 * LANES if branched(walls.law) else 12 * LANES
    for i in range(6 * LANES):
        w[(PAST + 12) * LANES + i] = past[slope + i]
    if branched(walls.law):
        for i in range(6 * LANES):
            w[(PAST + 18) * LANES + i] = past[24 * LANES + i]


@inlined
def _interpolate_history(w: Array, walls: Walls, a: Array, b: Array) -> None:
    """Load the same half-way between two nodes, as `time_stepping.interpolate_midpoints` does."""
    for c in range(12):
        for i in range(LANES):
            at, to = c * LANES + i, (12 + c) * LANES + i
            bent = 0.125 * w[STEP_LENGTH * LANES + i] * (a[to] - b[to])
            w[PAST * LANES + at] = 0.5 * (a[at] + b[at]) + bent
    own, slope = (24, 30) if branched(walls.law) else (0, 12)
    for c in range(6):
        for i in range(LANES):
            at, to, k = (own + c) * LANES + i, (slope + c) * LANES + i, (12 + c) * LANES + i
            w[PAST * LANES + k] = 1.5 / w[STEP_LENGTH * LANES + i] * (b[at] - a[at]) - 0.25 * (a[to] + b[to])
    if branched(walls.law):
        for c in range(6):
            for i in range(LANES):
                at, to = (24 + c) * LANES + i, (30 + c) * LANES + i
                bent = 0.125 * w[STEP_LENGTH * LANES + i] * (a[to] - b[to])
                w[(PAST + 18 + c) * LANES + i] = 0.5 * (a[at] + b[at]) + bent


@leaf
def integrate_lanes(
    rod: Rod, past: Array, moving: bool, first: int, last: int, states: Array, derivatives: Array, x: Array,
    inertia: Array,
) -> None:  # fmt: skip
    """The same where each lane has a history of its own.

    rod: the arm with one set of work arrays of the lanes. past (N + 1, 192 or 288): as of
    `lanes.SensitivityWorkspace`, history of strains, velocities and their derivatives at the nodes, and past strains of
    walls with Maxwell branches; read only if `moving`. inertia (K,): as of `LaneArguments`.
    """
    walls, line, size, n = rod.walls, rod.line, STATE * LANES, states.shape[0] - 1
    k = segment_at(line, first)
    w = rod.work[k]
    for j in range(first, last + 1):
        if j == last and last < n:
            break
        for i in range(size):
            states[j, i] = w[NODE * LANES + i]
        if moving:
            _load_history(w, walls, past[j])
        stage(rod, w, UNUSED_HISTORY, True, 2 * j, NODE, STAGE, 0.5)
        for i in range(12 * LANES):
            derivatives[j, i] = w[SLOPE * LANES + i]
        if j == n:
            break
        if j + 1 == line.first[k + 1]:
            end_wrench(w, walls, UNUSED_HISTORY, True, inertia[k])
            k += 1
            after = rod.work[k]
            if moving:
                _load_history(after, walls, past[j + 1])
            cross_joint(w, after, walls, UNUSED_HISTORY, True, x[j + 1], rod.scale)
            w = after
            continue
        if moving:
            _interpolate_history(w, walls, past[j], past[j + 1])
        stage(rod, w, UNUSED_HISTORY, True, 2 * j + 1, STAGE, THIRD, 0.5)
        stage(rod, w, UNUSED_HISTORY, True, 2 * j + 1, THIRD, FOURTH, 1.0)
        if moving:
            _load_history(w, walls, past[j + 1])
        stage(rod, w, UNUSED_HISTORY, True, 2 * j + 2, FOURTH, NODE, 1.0 / 6.0)
