"""The arm at rest."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model.errors import NotConverged, Unstable
from model.kernel_arguments import SOLVED, KernelArguments, pressures
from model.kernels.axis import axis
from model.kernels.equilibrium import UNSTABLE, equilibrium
from model.kernels.shooting import workspace_for
from model.loads import Loads
from model.shape import Shape

if TYPE_CHECKING:
    from model.arm import Arm

Array = NDArray[np.float64]


def solve(
    arm: Arm, pressure_pa: ArrayLike, loads: Loads | None, nodes: int | None, allow_unstable: bool = False
) -> Shape:
    """Behind `Arm.statics`."""
    pressure = pressures(arm, pressure_pa)
    problem = KernelArguments.of(arm, pressure[None])
    load, loaded = problem.load(arm, loads, steps_along(arm, nodes))
    x, stable = states(problem, pressure, problem.tip(loads), load, loaded)
    if not (stable or allow_unstable):
        raise Unstable.at(pressure)
    return shape(arm, problem, x, ok=True, stable=stable)


def steps_along(arm: Arm, nodes: int | None) -> int:
    """How many steps along the arm at rest: as many as asked for, at least two, or ValueError; else what it needs."""
    if nodes is None:
        return 4 * max(5, math.ceil(2.5 * arm.geometry.slenderness))
    if nodes < 2:
        raise ValueError(f"an arm needs at least two steps along it, got {nodes}")
    return nodes


def states(problem: KernelArguments, pressure: Array, tip: Array, load: Array, loaded: bool) -> tuple[Array, bool]:
    """States at the nodes, then their slopes, (2 N + 2, 16), of the arm at rest, and whether it is stable.

    Raises NotConverged where not even an unstable equilibrium is found.

    tip, load and loaded: as of `Problem`.
    """
    room = workspace_for(len(load) // 12)
    passes = equilibrium(
        problem.work(), problem.law, problem.actuators, problem.rest[0], problem.per_pressure[0], problem.free_per_pa,
        pressure, load, loaded, tip, problem.length_m, problem.scale, room, SOLVED,
    )  # fmt: skip
    if passes < 0 and passes != UNSTABLE:
        raise NotConverged.at(pressure)
    return room.x.copy(), passes != UNSTABLE


@lru_cache(maxsize=32)
def _points(length_m: float, n: int) -> Array:
    """Arc lengths at rest (n,), shared by every shape of an arm and so read-only."""
    s = np.linspace(0.0, length_m, n)
    s.flags.writeable = False
    return s


def shape(arm: Arm, problem: KernelArguments, x: Array, ok: bool, stable: bool | None = None) -> Shape:
    """The arm's axis from solved states."""
    n = len(x) // 2
    p, rotation, v, u = np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 3))
    axis(x, problem.length_m, problem.centre_m, p, rotation, v, u)
    return Shape(_points(problem.length_m, n), p, rotation, v, u, ok, arm.geometry.positions_m, stable)
