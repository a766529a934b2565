"""The kernel of arms at rest: their equilibria, and how their tips answer to small changes."""

from __future__ import annotations

from typing import Any

import numpy as np

from model.kernels.axis import place_tip
from model.kernels.equilibrium import UNSTABLE, equilibrium
from model.kernels.jit import kernel
from model.kernels.lanes import FIRST, Lanes, apply_pressure, apply_tip_load, places
from model.kernels.law import Walls
from model.kernels.layout import LANES
from model.kernels.shooting import Workspace
from model.kernels.tangents import tangents
from model.kernels.time_stepping import stiffen
from model.kernels.vec3 import leaf

Array = Any


@leaf
def _answers(x: Array, works: Array, room: Lanes, steps: Array, by: Array) -> None:
    """Derivatives (P, 6) of tip and rotation by each change of size steps (P,), after the tangents are solved."""
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


@kernel
def static_sensitivities(
    work: Array, works: Array, walls: Walls, stiffness: Array, rest: Array, per_pressure: Array,
    free: float, lane_stiffness: Array, lane_rest: Array, lane_per_pressure: Array, frees: Array, ends: Array,
    pressure: Array, tip_loads: Array, load: Array, loaded: bool, loaded_lanes: bool, heavy: bool, tip: Array,
    length: float, scale: Array, centre: Array, tolerance: float, solver: Workspace, room: Lanes, steps: Array,
    place: Array, turned: Array, by: Array, good: Array, unstable: Array,
) -> None:  # fmt: skip
    """One equilibrium per row of pressure (K, W, N, 8), and how its tip answers to each neighbour's change.

    The arm: work (size,), its sections stiffness (R, 24), rest (Q, 6), per_pressure (R, 6, N), tip (19,). The lanes:
    works (W, size) and as `apply_pressure` takes them, of the sections and of tip_loads one for each row or for all.
    Fills place (K, 3), turned (K, 3, 3), by (K, P, 6), good and unstable (K,).
    """
    row, here = np.empty(walls.actuators), tip.copy()
    nothing = np.zeros((works.shape[0], 1, 1))
    segments = room.shares.shape[0]
    for t in range(pressure.shape[0]):
        r, q = t % stiffness.shape[0], t % rest.shape[0]
        tip_load = tip_loads[t % tip_loads.shape[0]]
        apply_tip_load(tip, tip_load, here)
        for k in range(walls.actuators):
            row[k] = pressure[t, 0, k, 0]
        stiffen(work, stiffness[r])
        solved = equilibrium(
            work, walls, rest[q], per_pressure[r], free, row, load, loaded, here, length, scale, solver,
            tolerance,
        )  # fmt: skip
        good[t], unstable[t] = solved > 0, solved == UNSTABLE
        if solved > 0:
            place_tip(solver.x, length, centre, place, turned, t)
            if steps.shape[0] > 0:
                apply_pressure(
                    works, walls.actuators, lane_stiffness[r], lane_rest[q], lane_per_pressure[r], frees, ends,
                    pressure[t], tip_load,
                )  # fmt: skip
                found = tangents(
                    works, walls, nothing, load, loaded_lanes, 0.0, heavy, segments, scale, solver.x, room,
                    room.states[0], room.derivatives[0],
                )  # fmt: skip
                if found:
                    _answers(solver.x, works, room, steps, by[t])
                else:
                    by[t] = np.nan
        else:
            place[t] = np.nan
            turned[t] = np.nan
            by[t] = np.nan
