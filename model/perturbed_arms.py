"""An arm and its perturbed copies, side by side in the lanes of the sensitivity kernels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model.arm import Arm
from model.arrays import Array
from model.kernel_arguments import KernelArguments
from model.kernels import layout
from model.kernels.arguments import LaneArguments
from model.kernels.lanes import FIRST, work_arrays
from model.variation import TipWrench, Variation
from model.viscoelasticity import branch_factors


def lane_rows(rows: Array, changed: Sequence[Array | None]) -> Array:
    """Pressures (K, W, N, 8) by lane from those of the arm (K, N) and of its perturbed copies."""
    works = work_arrays(len(changed))
    out = np.empty((works * layout.LANES, *rows.shape))
    out[:] = rows
    for lane, own in enumerate(changed, start=FIRST):
        if own is not None:
            out[lane] = own
    split = out.reshape(works, layout.LANES, *rows.shape)
    return np.ascontiguousarray(split.transpose(2, 0, 3, 1))


def _lanes(order: NDArray[np.intp], values: Sequence[ArrayLike]) -> Array:
    """One value for each of the arm and its perturbed copies, by lane (W, .., 8)."""
    each = np.array(values, dtype=np.float64)[order].reshape(-1, layout.LANES, *np.shape(values[0]))
    return np.ascontiguousarray(np.moveaxis(each, 1, -1))


def lane_tip_loads(
    arm: Arm, changes: Sequence[Variation], count: int, weight_kg: ArrayLike | None, tip_wrench: TipWrench | None
) -> Array:
    """Loads at the tips beyond those of the cap, (count or 1, W, 12, 8), for `lanes.apply_pressure`."""
    weight = _weights(weight_kg, count)
    if tip_wrench is None and any(change.tip_wrench is not None for change in changes):
        raise ValueError("a change has a tip wrench, the arm has none")
    for some in (tip_wrench, *(change.tip_wrench for change in changes)):
        if some is not None and len(some.force_n) != count:
            raise ValueError(f"the tip wrench has {len(some.force_n)} rows, the pressures {count}")
    lanes = work_arrays(len(changes)) * layout.LANES
    tip_loads = np.zeros((lanes, count if tip_wrench is not None or weight.any() else 1, 12))
    own = [(arm, tip_wrench)] * lanes
    own[FIRST : FIRST + len(changes)] = [(change.arm, change.tip_wrench or tip_wrench) for change in changes]
    for lane, (one, pulls) in zip(tip_loads, own, strict=True):
        if weight.any():
            lane[:, :3] = weight[:, None] * np.asarray(one.gravity_m_s2)
        if pulls is not None:
            lane[:, :3] += pulls.force_n
            lane[:, 3:6], lane[:, 6:9], lane[:, 9:] = pulls.moment_n_m, pulls.force_n, pulls.point_m
    return np.ascontiguousarray(tip_loads.reshape(-1, layout.LANES, *tip_loads.shape[1:]).transpose(2, 0, 3, 1))


def _weights(weight_kg: ArrayLike | None, count: int) -> Array:
    weight = np.zeros(count) if weight_kg is None else np.array(weight_kg, dtype=np.float64)
    if weight.shape != (count,) or not np.isfinite(weight).all():
        raise ValueError(f"weight_kg must hold {count} finite numbers")
    return weight


@dataclass(frozen=True)
class PerturbedArms:
    """Kernel arguments of an arm and its perturbed copies; one wrench at rest for each row of pressures, or for all.

    first: of the arm. lanes: of the copies. load, loaded: distributed load of the arm. work: its work array. steps
    (P,): sizes of the changes. first_nodes: as of `KernelArguments.first_nodes`.
    """

    first: KernelArguments
    lanes: LaneArguments
    load: Array
    loaded: bool
    work: Array
    steps: Array
    first_nodes: NDArray[np.int64]

    @classmethod
    def of(
        cls, arm: Arm, changes: Sequence[Variation], nodes: int, rows: Array, c0: float = 0.0, dt_s: float = 0.0
    ) -> PerturbedArms:
        """Prepare the arguments for rows of pressures (K, N) [Pa]; they matter only to sections `by_pressure`."""
        arms, some = [arm, *(change.arm for change in changes)], len(rows)
        pressure = [rows, *(rows if change.pressure_pa is None else change.pressure_pa[:some] for change in changes)]
        each = [KernelArguments.of(one, own, c0, dt_s) for one, own in zip(arms, pressure, strict=True)]
        first = each[0]
        order = np.zeros(work_arrays(len(changes)) * layout.LANES, dtype=np.intp)
        order[FIRST : FIRST + len(changes)] = np.arange(1, len(arms))
        shape = len(order) // layout.LANES, len(first.prepared), first.prepared.shape[1] // layout.LANES, layout.LANES
        works = layout.aligned(*shape)
        works[:] = _lanes(order, [p.prepared[:, :: layout.LANES] for p in each])
        weight = [
            np.outer([s.line_density_kg_m * one.rod_weight for s in one.segments], one.gravity_m_s2) for one in arms
        ]
        heavier = [own - weight[0] for own in weight]
        first_nodes = first.first_nodes(nodes)
        works[:, :, layout.STEP_LENGTH] = _lanes(order, [p.line(first_nodes)[1] for p in each])
        works[:, :, layout.OWN_LOAD : layout.OWN_LOAD + 3] = _lanes(order, heavier)
        load, loaded = first.load(arm, None, first_nodes)
        rest = np.ascontiguousarray(_lanes(order, [p.rest for p in each]).swapaxes(0, 1))
        inertia = np.array([p.ends[:, 6:10].any(axis=1) for p in each]).any(axis=0)
        lanes = LaneArguments(
            works.reshape(*works.shape[:2], -1), rest, _lanes(order, [p.per_pressure for p in each]),
            _lanes(order, [p.free_per_pa for p in each]), _lanes(order, [p.ends for p in each]),
            loaded or bool(np.any(heavier)), inertia,
            _lanes(order, [branch_factors(one, c0, dt_s) for one in arms]), first.scale,
        )  # fmt: skip
        steps = np.array([change.step for change in changes], dtype=np.float64)
        return cls(first, lanes, load, loaded, first.work(), steps, first_nodes)

    def own(self, rows: slice) -> PerturbedArms:
        """The arguments for some rows, with separate work arrays."""
        lanes, first = self.lanes, self.first
        works = layout.aligned(*lanes.works.shape)
        works[:] = lanes.works
        at = slice(None) if len(lanes.rest) == 1 else rows
        first = replace(first, rest=first.rest[at])
        return replace(self, first=first, lanes=lanes._replace(works=works, rest=lanes.rest[at]), work=first.work())
