"""Arguments of the kernels for an arm."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from model.arm import Arm, Segment
from model.arrays import Array
from model.geometry import Geometry
from model.kernels import layout
from model.kernels.arguments import ArmArguments
from model.kernels.law import Walls, kernel_law
from model.loads import Loads
from model.section import CrossSection, section, upper
from model.units import PA_PER_BAR
from model.variants import DEFAULT_TUBE_LAW
from model.viscoelasticity import viscous_time_s


@dataclass(frozen=True)
class KernelArguments:
    """One arm of K segments, as arguments of the kernels. The line of the rod is the centroid of the walls.

    prepared (K, 8 size): work arrays with the sections in them. rest (Q, K, 6): the wrench at zero strain without the
    part in proportion to the pressures; one for each row of pressures if the push grows, else one for all. ends
    (K, 19): loads of couplings and cap, in the order of `layout.TIP_LOAD`. joint, centre: as of
    `kernels.arguments.Line`. Equal arms share these arrays, which are never written to; `work` makes a copy for the
    kernels.
    """

    walls: Walls
    prepared: Array
    rest: Array
    per_pressure: Array
    free_per_pa: Array
    chambers: NDArray[np.int64]
    lengths_m: Array
    length_m: float
    joint: Array
    centre: Array
    scale: Array
    ends: Array
    kept_nodes: dict[int, NDArray[np.int64]] = field(default_factory=dict, repr=False)
    """Results of `first_nodes`, and of `line`, which arms that differ in their loads share."""
    kept_lines: dict[bytes, tuple[Any, ...]] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, arm: Arm, pressure_pa: Array, c0: float = 0.0, dt_s: float = 0.0) -> KernelArguments:
        """Prepare the arm, at rest or for time steps of dt_s [s] of a scheme with c0.

        Pressures (R, A) [Pa] matter only to an arm whose sections differ `by_pressure`.
        """
        prepared = _prepared(arm, c0, dt_s)
        if arm.actuation.grows:
            rest = np.repeat(prepared.rest, len(pressure_pa), axis=0)
            for k, segment in enumerate(arm.segments):
                own = pressure_pa[:, prepared.chambers[k] : prepared.chambers[k + 1]]
                beyond = arm.actuation.push_pa(own) - own
                # No matrix product: its rounding depends on the number of rows.
                rest[:, k] += (beyond[:, None, :] * _push_wrench(segment.geometry)).sum(axis=2)
            prepared = replace(prepared, rest=rest)
        return prepared

    @classmethod
    def _build(cls, arm: Arm, c0: float, dt_s: float) -> KernelArguments:
        segments = arm.segments
        places = max(segment.geometry.actuators for segment in segments)
        chambers = np.cumsum([0, *(segment.geometry.actuators for segment in segments)])
        centre = np.array([_tubes(segment.geometry).centre_m for segment in segments])
        rest, per_pressure = np.zeros((1, len(segments), 6)), np.zeros((len(segments), 6, chambers[-1]))
        lanes, joint = [], np.zeros((len(segments), 3))
        for k, segment in enumerate(segments):
            geometry, tubes = segment.geometry, _tubes(segment.geometry)
            stiffness_n = np.full(geometry.actuators, segment.stiffness_n)
            whole = section(geometry, tubes.xy_m, stiffness_n, segment.material.shear_ratio, segment.rpe_per_bar)
            if segment.law.pointwise:
                # The law of each tube holds the strain at rest and the free strain; the push on the caps remains.
                whole = CrossSection(whole.axial, whole.shear, np.zeros(6), _push_wrench(geometry))
            rest[0, k], per_pressure[k, :, chambers[k] : chambers[k + 1]] = whole.rest, whole.per_pressure
            if k:
                joint[k - 1] = *(centre[k] - centre[k - 1]), segment.coupling.length_m
            theta = viscous_time_s(segment.material, c0, dt_s)
            lanes.append(_lane(segment, tubes, whole, c0, theta, places, moves=arm.inertia or not c0))
        for k, lane in enumerate(lanes):
            lane[layout.CENTRE : layout.CENTRE + 2], lane[layout.JOINT : layout.JOINT + 3] = centre[k], joint[k]
        length = arm.length_m
        return cls(
            # At rest branches carry no load.
            walls=_walls(arm, places, branched=bool(arm.branches) and c0 > 0),
            prepared=np.repeat(np.array(lanes), layout.LANES, axis=1),
            rest=rest,
            per_pressure=per_pressure,
            free_per_pa=np.array([segment.rpe_per_bar / PA_PER_BAR for segment in segments]),
            chambers=chambers,
            lengths_m=np.array([segment.geometry.length_m for segment in segments]),
            length_m=length,
            joint=joint,
            centre=centre,
            scale=_scale(length, c0),
            ends=_ends(arm, centre),
        )

    def arm(self, work: Array, ends: Array, load: Array, loaded: bool, first: NDArray[np.int64]) -> ArmArguments:
        """The arm with work arrays, loads at the ends (K, 19), a distributed load, and the first nodes of `nodes`."""
        return ArmArguments(
            work, self.rest, self.per_pressure, self.free_per_pa, self.chambers, load, loaded, ends, self.length_m,
            self.scale, self.line(first),
        )  # fmt: skip

    def first_nodes(self, nodes: int) -> NDArray[np.int64]:
        """First node of each segment (K + 1,), then N + 1, for N steps and joints along the arm.

        Raises:
            ValueError: fewer than two steps for each segment.
        """
        if nodes not in self.kept_nodes:
            self.kept_nodes[nodes] = _first_nodes(tuple(self.lengths_m.tolist()), nodes)
        return self.kept_nodes[nodes]

    def line(self, first: NDArray[np.int64]) -> tuple[Any, ...]:
        """Fields of `kernels.arguments.Line`."""
        key = first.tobytes()
        if key not in self.kept_lines:
            self.kept_lines[key] = first, self.lengths_m / (np.diff(first) - 1), self.joint, self.centre
        return self.kept_lines[key]

    def work(self) -> Array:
        """Work arrays for the kernels to write to."""
        work = layout.aligned(*self.prepared.shape)
        work[:] = self.prepared
        return work

    def ends_with(self, loads: Loads | None) -> Array:
        """Loads at the ends of the segments (K, 19), in the order of `layout.TIP_LOAD`."""
        if loads is None:
            return self.ends
        ends = self.ends.copy()
        ends[-1, :6] += loads.tip()
        ends[-1, 13:] += loads.eccentric_force()
        return ends

    def load(self, arm: Arm, loads: Loads | None, first: NDArray[np.int64]) -> tuple[Array, bool]:
        """Distributed load at nodes and mid-points (2 N + 1 rows of 6, flat), and whether there is any."""
        rows = 2 * int(first[-1]) - 1
        if loads is None and not arm.rod_weight:
            return _no_load(rows), False
        along = np.zeros((rows, 6)) if loads is None else loads.along(self._shares(first, rows))
        if arm.rod_weight:
            for segment, begin, end in zip(arm.segments, first, first[1:], strict=False):
                along[2 * begin : 2 * end - 1, :3] += segment.line_density_kg_m * np.asarray(arm.gravity_m_s2)
        return along.reshape(-1), bool(along.any())

    def _shares(self, first: NDArray[np.int64], rows: int) -> Array:
        """Arc lengths (2 N + 1,) of nodes and mid-points as shares of the length of the arm."""
        if len(first) == 2:
            return np.linspace(0.0, 1.0, rows)
        out, start = np.zeros(rows), 0.0
        for k, (begin, end) in enumerate(pairwise(first)):
            after = start + float(self.lengths_m[k])
            out[2 * begin : 2 * end - 1] = np.linspace(start, after, 2 * (end - begin) - 1) / self.length_m
            start = after + float(self.joint[k, 2])
        return out


@lru_cache(maxsize=64)
def _first_nodes(lengths_m: tuple[float, ...], nodes: int) -> NDArray[np.int64]:
    steps = nodes - (len(lengths_m) - 1)
    if steps < 2 * len(lengths_m):
        raise ValueError(
            f"an arm of {len(lengths_m)} segments needs at least {3 * len(lengths_m) - 1} steps and joints along it, "
            f"got {nodes}"
        )
    # Steps by length, by the largest remainder; two at least.
    ideal = steps * np.array(lengths_m) / sum(lengths_m)
    each = np.maximum(2, np.floor(ideal).astype(np.int64))
    while each.sum() != steps:
        change = 1 if each.sum() < steps else -1
        room = change * (ideal - each) if change > 0 else np.where(each > 2, each - ideal, -np.inf)
        each[int(np.argmax(room))] += change
    return np.concatenate([[0], np.cumsum(each + 1)]).astype(np.int64)


@dataclass(frozen=True)
class _Tubes:
    """Numbers of the tubes that depend on the geometry only.

    centre_m (2,): centroid of the walls. xy_m (N, 2): positions about it. numbers (N, 8): in the order of
    `layout.TRIO`. second_moments_m4 (4,): of all walls about the centroid: 11, 22, 12, 33.
    """

    centre_m: Array
    xy_m: Array
    numbers: Array
    second_moments_m4: Array


@lru_cache(maxsize=64)
def _tubes(geometry: Geometry) -> _Tubes:
    centre = geometry.centroid_m
    xy = geometry.positions_m - centre
    area, second = geometry.wall_area_m2, geometry.wall_second_moment_m4
    x, y = xy.T
    xx, yy, xys = (area * x * x + second).sum(), (area * y * y + second).sum(), (area * x * y).sum()
    numbers = np.zeros((len(xy), layout.PER_TUBE))
    numbers[:, 0], numbers[:, 1], numbers[:, 3] = x, y, 1.0
    numbers[:, 4], numbers[:, 5], numbers[:, 6] = x * x, x * y, y * y
    numbers[:, 7] = x * x + y * y + 2.0 * second / area
    return _Tubes(centre, xy, numbers, np.array([yy, xx, -xys, xx + yy]))


@lru_cache(maxsize=32)
def _no_load(rows: int) -> Array:
    return np.zeros(6 * rows)


def _walls(arm: Arm, places: int, branched: bool) -> Walls:
    law = next((s.law.tube_law for s in arm.segments if s.law.tube_law), DEFAULT_TUBE_LAW)
    return Walls(kernel_law(law.name, law.response, branched), places)


@lru_cache(maxsize=64)
def _push_wrench(geometry: Geometry) -> Array:
    """Wrench (6, N) per pascal of each push pressure, about the centroid of the walls."""
    xy = geometry.positions_m - geometry.centroid_m
    return section(geometry, xy, np.zeros(len(xy)), 1.0, 0.0).per_pressure


def _ends(arm: Arm, centre: Array) -> Array:
    ends = np.zeros((len(arm.segments), layout.TIP_LOAD_SIZE))
    gravity = np.asarray(arm.gravity_m_s2)
    for end, segment in zip(ends, arm.segments[1:], strict=False):
        end[:3] = segment.coupling.mass_kg * gravity
        end[6] = segment.coupling.mass_kg * arm.inertia
        end[12] = 0.5 * segment.coupling.length_m
    ends[-1, :3] = arm.cap_mass_kg * gravity
    if arm.cap_inertia and arm.inertia:
        ends[-1, 6] = arm.cap_mass_kg
        ends[-1, 7:10] = arm.cap_inertia_kg_m2
    ends[:, 10:12] = -centre
    return ends


@lru_cache(maxsize=64)
def _prepared(arm: Arm, c0: float, dt_s: float) -> KernelArguments:
    # Gravity and cap enter the loads at the ends only: arms that differ in nothing else share the sections.
    nothing = (0.0, 0.0, 0.0)
    shared = _prepared_without_cap(
        replace(arm, gravity_m_s2=nothing, cap_mass_kg=0.0, cap_inertia_kg_m2=nothing), c0, dt_s
    )
    return replace(shared, ends=_ends(arm, shared.centre))


@lru_cache(maxsize=64)
def _prepared_without_cap(arm: Arm, c0: float, dt_s: float) -> KernelArguments:
    return KernelArguments._build(arm, c0, dt_s)


_UPPER = upper(np.arange(9).reshape(3, 3))


@lru_cache(maxsize=64)
def _scale(length_m: float, c0: float) -> Array:
    """Magnitudes of (v, u, q, w, h) for Newton's method, then their reciprocals (32,).

    Velocities are scaled by the displacement within a time step.
    """
    one, curvature = np.ones(3), np.full(3, 1 / length_m)
    carried = max(1.0, 0.25 * c0 * length_m)
    scale = np.concatenate([one, curvature, carried * one, carried * curvature, np.ones(4)])
    return np.concatenate([scale, 1 / scale])


def _lane(
    segment: Segment, tubes: _Tubes, whole: CrossSection, c0: float, theta: float, places: int, *, moves: bool
) -> Array:
    """One lane of the work array of a segment. moves: whether it has inertia; the search for an equilibrium does."""
    geometry, material, law = segment.geometry, segment.material, segment.law
    factor = 1 + theta * c0
    blocks = np.empty((4, 3, 3))
    blocks[0], blocks[1] = whole.axial, whole.shear
    blocks[2:] = np.linalg.inv(blocks[:2]) / factor
    blocks[:2] *= theta if law.pointwise else factor
    lane = np.zeros(layout.work_size(places) // layout.LANES)
    lane[layout.C0], lane[layout.LINE_DENSITY] = c0, segment.line_density_kg_m * moves
    lane[layout.INERTIA : layout.LAG] = material.density_kg_m3 * tubes.second_moments_m4 * moves
    lane[layout.LAG] = theta / factor
    lane[layout.AXIAL : layout.OFFSET] = blocks.reshape(4, 9)[:, _UPPER].ravel()
    lane[layout.OFFSET : layout.TUBE] = whole.rest
    lane[layout.TUBE], lane[layout.TUBE + 1] = (
        material.shear_ratio,
        geometry.wall_second_moment_m4 / geometry.wall_area_m2,
    )
    constants = law.constants(material, geometry)
    if len(constants) > layout.LAW_CONSTANTS:
        raise ValueError(f"the law {law.name} has {len(constants)} constants, the kernels take {layout.LAW_CONSTANTS}")
    lane[layout.LAW : layout.LAW + len(constants)] = constants
    lane[layout.POINTWISE] = law.pointwise
    first = layout.tubes_at(places)
    lane[first : first + tubes.numbers.size] = tubes.numbers.ravel()
    return lane
