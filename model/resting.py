"""The kernel of arms at rest: their equilibria, and how their tips answer to small changes."""

from __future__ import annotations

from typing import Any

import numpy as np

from model.axis import place_tip
from model.compiled import kernel
from model.lanes import FIRST, Lanes, places, press
from model.layout import LANES, STATE
from model.march import equilibrium
from model.neighbours import neighbours
from model.shooting import Room, newton
from model.triples import cross, leaf, plus, rotation

Array = Any

# The lever of a pull turns with the tip: it is found anew until it stands still, or the pull is not met.
LEVER_PASSES, LEVER_STILL = 80, 1e-8
NO_MOMENT = 1e-15  # [N m]: a pull so small that its moments have no digits


@leaf
def _answers(x: Array, works: Array, room: Lanes, steps: Array, by: Array) -> None:
    """How tip and turn answer (P, 6) to each neighbour's change of size steps (P,), after `neighbours` in one go."""
    n = room.states.shape[2] - 1
    for p in range(works.shape[0]):
        places(works[p], room.states[0, p], room.derivatives[0, p], x[n], room.place[p])
    for f in range(steps.shape[0]):
        p, i = (FIRST + f) // LANES, (FIRST + f) % LANES
        for c in range(6):
            total = room.place[p, c, i] - room.place[0, c, 0]
            for k in range(6):
                total += room.shares[0, p, k, i] * (room.place[0, c, 1 + k] - room.place[0, c, 0])
            by[f, c] = total / steps[f]


@leaf
def _lever(x: Array, pull: Array, tip: Array, before: Array, share: float) -> float:
    """Move the tip's load from the pull's moment `before` (3,) by a share towards that of its lever now; how far off.

    pull (6, 8): force and lever, of which lane 0 counts. The moment is about the axis' end.
    """
    h = x[x.shape[0] // 2 - 1]
    d1, d2, d3 = rotation((h[12], h[13], h[14], h[15]))
    at = (pull[3, 0], pull[4, 0], pull[5, 0])
    arm = plus(plus((at[0] * d1[0], at[0] * d1[1], at[0] * d1[2]), at[1], d2), at[2], d3)
    moment = cross(arm, (pull[0, 0], pull[1, 0], pull[2, 0]))
    largest = 0.0
    for c in range(3):
        change = moment[c] - before[c]
        largest = max(largest, abs(change))
        tip[3 + c] += share * change
        before[c] += share * change
    return largest


@kernel
def resting(
    work: Array, works: Array, law: int, actuators: int, rest: Array, per_pressure: Array, free: Array, rests: Array,
    per_pressures: Array, frees: Array, ends: Array, pressure: Array, hung: Array, pull: Array, load: Array,
    loaded: bool, loaded_lanes: bool, heavy: bool, tip: Array, length: float, scale: Array, centre: Array,
    tolerance: float, solver: Room, room: Lanes, steps: Array, place: Array, turned: Array, by: Array, good: Array,
) -> None:  # fmt: skip
    """One equilibrium per row of pressure (K, W, N, 8), and how its tip answers to each neighbour's change.

    The arm: work (R, size), rest (R, 6), per_pressure (R, 6, N), free (R,), tip (13,). The lanes: works (R, W, size)
    and as `press` takes them, with R before. R and the rows of hung and pull are K, or 1 for the same everywhere.
    Fills place (K, 3), turned (K, 3, 3), by (K, P, 6) and good (K,).
    """
    n = solver.states.shape[0] - 1
    row, here, lever = np.empty(actuators), tip.copy(), np.empty(3)
    nothing = np.zeros((works.shape[1], 1, 1))
    segments = room.shares.shape[0]
    for t in range(pressure.shape[0]):
        r = t % work.shape[0]
        hangs, pulls = hung[t % hung.shape[0]], pull[t % pull.shape[0]]
        for k in range(actuators):
            row[k] = pressure[t, 0, k, 0]
        for c in range(6):
            here[c] = tip[c] + hangs[0, c, 0]
        pulled = 0.0
        for c in range(3):
            pulled += abs(pulls[0, c, 0])
            lever[c] = 0.0
        if pulled > 0.0:
            for c in range(STATE):
                solver.x[n, c] = 1.0 if c == 12 else 0.0
            _lever(solver.x, pulls[0], here, lever, 1.0)
        solved = equilibrium(
            work[r], law, actuators, rest[r], per_pressure[r], free[r], row, load, loaded, here, length, scale, solver,
            tolerance,
        )  # fmt: skip
        if pulled > 0.0:
            still, share, last = False, 1.0, np.inf
            for _ in range(LEVER_PASSES):
                if solved > 0 and not still:
                    off = _lever(solver.x, pulls[0], here, lever, share)
                    still = off <= LEVER_STILL * pulled + NO_MOMENT
                    # A strong pull turns the tip by more than the lever was off: then smaller steps.
                    share = max(0.1, 0.5 * share) if off > 0.7 * last else share
                    last = off
                    if not still:
                        solved = newton(
                            work[r], law, actuators, load, loaded, here, 0.0, length, segments, scale, solver,
                            tolerance, 20.0,
                        )  # fmt: skip
            if not still:
                solved = -1
        good[t] = solved > 0
        if solved > 0:
            place_tip(solver.x, length, centre, place, turned, t)
            if steps.shape[0] > 0:
                press(works[r], actuators, rests[r], per_pressures[r], frees[r], ends, pressure[t], hangs, pulls)
                found = neighbours(
                    works[r], law, actuators, nothing, load, loaded_lanes, 0.0, heavy, segments, scale,
                    solver.x, room, room.states[0], room.derivatives[0],
                )  # fmt: skip
                if found:
                    _answers(solver.x, works[r], room, steps, by[t])
                else:
                    by[t] = np.nan
        else:
            place[t] = np.nan
            turned[t] = np.nan
            by[t] = np.nan
