"""Many rods in one call on all cores: parameter sets, Monte-Carlo samples, grids of pressures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model.arm import Arm
from model.arrays import Array
from model.dynamics import ArmTrajectory, Dynamics
from model.kernel_arguments import KernelArguments
from model.kernels import layout
from model.kernels.arguments import ArmArguments
from model.kernels.axis import equilibria
from model.kernels.shooting import TOLERANCE_AT_REST, workspace_size
from model.processors import usable_processors
from model.schemes import DEFAULT_ALPHA, DEFAULT_SCHEME
from model.statics import steps_along

ROWS_PER_THREAD = 150
"""Fewer rows are solved sooner than a further thread starts."""
AT_ONCE = 1024  # arms whose kernel arguments are in memory at once


@dataclass(frozen=True)
class Tips:
    """Tips of B arms at rest: tip_m (B, 3), tip_rotation (B, 3, 3), ok (B,).

    NaN without a stable equilibrium; unstable (B,): whether an unstable one was found.
    """

    tip_m: Array
    tip_rotation: Array
    ok: NDArray[np.bool_]
    unstable: NDArray[np.bool_]


def statics(
    arms: Arm | Sequence[Arm], pressure_pa: ArrayLike, nodes: int | None = None, workers: int | None = None
) -> Tips:
    """Tips at rest for rows of pressure_pa (B, N) [Pa]: one arm for all rows, or one arm per row.

    The arms must share the numbers of actuators and branches, and their laws. nodes: steps along each
    arm, by default as many as the most slender one needs. Raises ValueError for other arms and shapes.
    """
    # The kernels are compiled for this order in memory.
    rows = np.array(pressure_pa, dtype=np.float64, order="C")
    given = [arms] if isinstance(arms, Arm) else list(arms)
    _check(given, rows, 2)
    steps = max(steps_along(arm, nodes) for arm in given)
    count = len(rows)
    place, turned = np.empty((count, 3)), np.empty((count, 3, 3))
    good, unstable = np.empty(count, dtype=np.bool_), np.empty(count, dtype=np.bool_)

    def part(span: range) -> None:
        pool = layout.aligned(workspace_size(steps))
        for start in range(span.start, span.stop, AT_ONCE):
            at = slice(start, min(start + AT_ONCE, span.stop))
            if len(given) == 1:
                mine, problems = given, [KernelArguments.of(given[0], rows[at])]
            else:
                mine = given[at]
                problems = [KernelArguments.of(arm, row[None]) for arm, row in zip(mine, rows[at], strict=True)]
            first = problems[0]
            nodes = first.first_nodes(steps)
            loads = [problem.load(arm, None, nodes) for problem, arm in zip(problems, mine, strict=True)]
            lines = [problem.line(nodes) for problem in problems]
            works = layout.aligned(len(problems), *first.prepared.shape)
            works[:] = [p.prepared for p in problems]
            arms_here = ArmArguments(
                work=works,
                rest=np.concatenate([p.rest for p in problems]),
                per_pressure=np.array([p.per_pressure for p in problems]),
                free_per_pa=np.array([p.free_per_pa for p in problems]),
                chambers=first.chambers,
                load=np.array([load for load, _ in loads]),
                loaded=any(loaded for _, loaded in loads),
                ends=np.array([p.ends for p in problems]),
                length=np.array([p.length_m for p in problems]),
                scale=np.array([p.scale for p in problems]),
                line=(nodes, *(np.array([line[c] for line in lines]) for c in (1, 2, 3))),
            )
            tips = place[at], turned[at], good[at]
            equilibria(first.walls, tuple(arms_here), rows[at], pool, TOLERANCE_AT_REST, tips, unstable[at])

    spread(part, count, workers, ROWS_PER_THREAD)
    return Tips(place, turned, good, unstable)


def motions(
    arms: Arm | Sequence[Arm],
    pressure_pa: ArrayLike,
    dt_s: float,
    scheme: str = DEFAULT_SCHEME,
    alpha: float = DEFAULT_ALPHA,
    nodes: int | None = None,
    workers: int | None = None,
) -> list[ArmTrajectory]:
    """B motions under pressure_pa (B, T + 1, N) [Pa], each starting at rest under its first row."""
    paths = np.array(pressure_pa, dtype=np.float64)
    given = [arms] if isinstance(arms, Arm) else list(arms)
    _check(given, paths, 3)
    found: dict[int, ArmTrajectory] = {}

    def part(span: range) -> None:
        for b in span:
            dynamics = Dynamics(given[b % len(given)], dt_s, scheme, alpha, nodes)
            dynamics.start(paths[b, 0])
            found[b] = dynamics.run(paths[b, 1:])

    spread(part, len(paths), workers)
    return [found[b] for b in range(len(paths))]


def _check(arms: list[Arm], pressure: Array, axes: int) -> None:
    if not arms:
        raise ValueError("no arm given")
    kinds = {arm.kind for arm in arms}
    if len(kinds) > 1:
        raise ValueError(f"the arms of a batch must share actuators, laws and branches, got {sorted(kinds)}")
    actuators = arms[0].actuators
    if pressure.ndim != axes or pressure.shape[-1] != actuators:
        raise ValueError(f"pressure_pa must have {axes} axes, the last of {actuators}, got shape {pressure.shape}")
    if len(arms) not in (1, len(pressure)):
        raise ValueError(f"{len(arms)} arms for {len(pressure)} rows of pressure: give one arm, or one per row")
    if not np.isfinite(pressure).all():
        raise ValueError("pressures must be finite")


def spread(part: Callable[[range], None], count: int, workers: int | None, least: int = 1) -> None:
    """Run part(range) over contiguous ranges of the rows on `workers` threads; the kernels release the GIL.

    By default one thread per processor of this process, as long as each has at least `least` rows.
    """
    threads = max(1, min(count, workers) if workers is not None else min(count // least, usable_processors()))
    edges = [count * k // threads for k in range(threads + 1)]
    spans = [range(a, b) for a, b in pairwise(edges)]
    if threads == 1:
        part(spans[0] if spans else range(0))
        return
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(part, spans))
