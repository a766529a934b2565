"""The arm at rest."""

from __future__ import annotations

import math
import threading
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model.arm import Arm
from model.arrays import Array
from model.errors import NotConverged, Unstable
from model.kernel_arguments import KernelArguments
from model.kernels.axis import axis
from model.kernels.equilibrium import UNSTABLE, solve_equilibrium
from model.kernels.layout import aligned
from model.kernels.shooting import TOLERANCE_AT_REST, workspace_for
from model.loads import Loads
from model.pressures import pressures, refuse_other_units
from model.shape import Shape

# Beyond this a shape or a time step would take seconds, and then more memory than there is.
MOST_NODES = 20_000


def statics(
    arm: Arm,
    pressure_pa: ArrayLike,
    loads: Loads | None = None,
    nodes: int | None = None,
    *,
    allow_unstable: bool = False,
    doubt_units: bool = True,
) -> Shape:
    """The stable shape at rest under gauge pressures (N,) [Pa].

    nodes: steps along the arm (RK4), the joints between its segments counted in; by default 20, or ten for each width
    of its length where it is slender, which leaves an error below 1e-8 m at the paper's pressures
    (docs/explanation/model.md says where not).

    doubt_units: refuse pressures that are plausible only in another unit; False for measured pressures, which may
    have any value.

    Raises:
        ValueError: pressures or loads that are not finite, of the wrong shape, or of another unit.
        NotConverged: no equilibrium is found.
        Unstable: only an unstable equilibrium is found; with `allow_unstable` it is returned, `stable` False.
    """
    pressure = pressures(arm, pressure_pa)
    if doubt_units:
        refuse_other_units(pressure)
    arguments = KernelArguments.of(arm, pressure[None])
    first = arguments.first_nodes(steps_along(arm, nodes))
    load, loaded = arguments.load(arm, loads, first)
    x, stable = states(arguments, pressure, arguments.ends_with(loads), load, loaded, first)
    if not (stable or allow_unstable):
        raise Unstable.at(pressure)
    return shape(arm, arguments, x, first, ok=True, stable=stable)


def steps_along(arm: Arm, nodes: int | None) -> int:
    """Return the number of steps along an arm at rest: `nodes`, or by default what its slenderness needs.

    Raises:
        ValueError: fewer than two, or more than MOST_NODES.
    """
    if nodes is None:
        nodes = 4 * max(5, math.ceil(2.5 * arm.slenderness))
    if nodes < 2:
        raise ValueError(f"an arm needs at least two steps along it, got {nodes}")
    if nodes > MOST_NODES:
        raise ValueError(f"an arm may have at most {MOST_NODES} steps along it, got {nodes}")
    return nodes


class _Arrays(threading.local):
    """Work arrays of static solutions, allocated once for each thread."""

    def __init__(self) -> None:
        self.work = lru_cache(maxsize=4)(aligned)


_arrays = _Arrays()


def states(
    arguments: KernelArguments, pressure: Array, ends: Array, load: Array, loaded: bool, first: NDArray[np.int64]
) -> tuple[Array, bool]:
    """States at the nodes, then their derivatives, (2 N + 2, 16), of the arm at rest, and whether it is stable.

    ends, load and loaded: as of `ArmArguments`; first: as of `Line`. Raises NotConverged if not even an unstable one is
    found.
    """
    pool, workspace = workspace_for(len(load) // 12)
    work = _arrays.work(*arguments.prepared.shape)
    work[:] = arguments.prepared
    arm_fields = tuple(arguments.arm(work, ends, load, loaded, first))
    passes = solve_equilibrium(arguments.walls, arm_fields, pressure, pool, TOLERANCE_AT_REST)
    if passes < 0 and passes != UNSTABLE:
        raise NotConverged.at(pressure)
    return workspace.x.copy(), passes != UNSTABLE


@lru_cache(maxsize=32)
def _points(lengths_m: tuple[float, ...], gaps_m: tuple[float, ...], first: tuple[int, ...]) -> Array:
    """Arc lengths at rest (n,), shared by every shape of an arm and so read-only."""
    parts, start = [], 0.0
    for length, gap, begin, end in zip(lengths_m, gaps_m, first, first[1:], strict=False):
        parts.append(np.linspace(start, start + length, end - begin))
        start += length + gap
    s = np.concatenate(parts)
    s.flags.writeable = False
    return s


def shape(
    arm: Arm, arguments: KernelArguments, x: Array, first: NDArray[np.int64], ok: bool, stable: bool | None = None
) -> Shape:
    """The arm's axis from solved states."""
    n = len(x) // 2
    p, rotation, v, u = np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 3))
    axis(x, arguments.line(first), p, rotation, v, u)
    if len(arm.segments) == 1:
        s = _points((arguments.length_m,), (0.0,), (0, n))
        return Shape(s, p, rotation, v, u, ok, arm.geometry.positions_m, stable)
    nodes, chambers = tuple(first.tolist()), tuple(arguments.chambers.tolist())
    s = _points(tuple(arguments.lengths_m.tolist()), tuple(arguments.joint[:, 2].tolist()), nodes)
    places = np.concatenate([segment.geometry.positions_m for segment in arm.segments])
    return Shape(s, p, rotation, v, u, ok, places, stable, nodes, chambers)
