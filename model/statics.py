"""The arm at rest."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model.axis import axis
from model.errors import NotConverged
from model.loads import Loads
from model.march import equilibrium
from model.problem import SOLVED, Problem, pressures
from model.shape import Shape
from model.shooting import room_for

if TYPE_CHECKING:
    from model.arm import Arm

Array = NDArray[np.float64]


def solve(arm: Arm, pressure_pa: ArrayLike, loads: Loads | None, nodes: int) -> Shape:
    """Behind `Arm.statics`."""
    pressure = pressures(arm, pressure_pa)
    problem = Problem.of(arm, pressure)
    return shape(arm, problem, states(arm, problem, pressure, loads, nodes), ok=True)


def states(arm: Arm, problem: Problem, pressure: Array, loads: Loads | None, nodes: int) -> Array:
    """States at the nodes, then their slopes, (2 N + 2, 16), of the arm at rest; raises NotConverged."""
    if nodes < 2:
        raise ValueError(f"an arm needs at least two steps along it, got {nodes}")
    room = room_for(nodes)
    load, loaded = problem.load(arm, loads, nodes)
    passes = equilibrium(
        problem.work, problem.law, problem.actuators, problem.rest, problem.per_pressure, problem.free_per_pa, pressure,
        load, loaded, problem.tip(arm, loads), problem.length_m, problem.scale, room, SOLVED,
    )  # fmt: skip
    if passes < 0:
        bar = ", ".join(f"{value / 1e5:.4g}" for value in pressure)
        raise NotConverged(f"no equilibrium found at {bar} bar: a pressure or load may be far outside the arm's range")
    x: Array = room.x.copy()
    return x


@lru_cache(maxsize=32)
def _points(length_m: float, n: int) -> Array:
    """Arc lengths at rest (n,), shared by every shape of an arm and so read-only."""
    s = np.linspace(0.0, length_m, n)
    s.flags.writeable = False
    return s


def shape(arm: Arm, problem: Problem, x: Array, ok: bool) -> Shape:
    """The arm's axis from solved states."""
    n = len(x) // 2
    p, rotation, v, u = np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 3))
    axis(x, problem.length_m, problem.centre_m, p, rotation, v, u)
    return Shape(_points(problem.length_m, n), p, rotation, v, u, ok, arm.geometry.positions_m)
