"""Arguments of the kernels for an arm."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from model.arm import Arm
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
    """One arm on N + 1 nodes, as arguments of the kernels. The line of the rod is the centroid of the walls.

    stiffness (1, 24), per_pressure (1, 6, N): the section. rest (Q, 6): the wrench at zero strain without the part in
    proportion to the pressures; one for each row of pressures if the push grows, else one for all. prepared (8 size,):
    a work array with the section in it. cap (19,): load at the tip by the cap, in the order of `layout.TIP_LOAD`.
    Equal arms share these arrays, which are never written to; `work` makes a copy for the kernels.
    """

    walls: Walls
    prepared: Array
    stiffness: Array
    rest: Array
    per_pressure: Array
    free_per_pa: float
    centre_m: Array
    length_m: float
    scale: Array
    cap: Array

    @classmethod
    def of(cls, arm: Arm, pressure_pa: Array, c0: float = 0.0, dt_s: float = 0.0) -> KernelArguments:
        """Prepare the arm, at rest or for time steps of dt_s [s] of a scheme with c0.

        Pressures (R, N) [Pa] matter only to an arm whose sections differ `by_pressure`.
        """
        theta = viscous_time_s(arm.material, c0, dt_s)
        prepared = _prepared(arm, c0, theta)
        if arm.actuation.grows:
            beyond = arm.actuation.push_pa(pressure_pa) - pressure_pa
            # No matrix product: its rounding depends on the number of rows.
            wrench = (beyond[:, None, :] * _push_wrench(arm.geometry)).sum(axis=2)
            prepared = replace(prepared, rest=prepared.rest + wrench)
        return prepared

    @classmethod
    def _build(cls, arm: Arm, c0: float, theta: float) -> KernelArguments:
        geometry, material, tubes = arm.geometry, arm.material, _tubes(arm.geometry)
        stiffness_n = np.full(geometry.actuators, arm.stiffness_n)
        whole = section(geometry, tubes.xy_m, stiffness_n, material.shear_ratio, arm.rpe_per_bar)
        if arm.law.pointwise:
            # The law of each tube holds the strain at rest and the free strain; the push on the caps remains.
            whole = CrossSection(whole.axial, whole.shear, np.zeros(6), _push_wrench(geometry))
        lane = _lane(arm, tubes, whole, c0, theta)
        return cls(
            # At rest branches carry no load.
            walls=_walls(arm, branched=bool(material.branches) and c0 > 0),
            prepared=np.repeat(lane, layout.LANES),
            stiffness=lane[None, layout.AXIAL : layout.OFFSET].copy(),
            rest=whole.rest[None],
            per_pressure=whole.per_pressure[None],
            free_per_pa=arm.rpe_per_bar / PA_PER_BAR,
            centre_m=tubes.centre_m,
            length_m=geometry.length_m,
            scale=_scale(geometry.length_m, c0),
            cap=_cap(arm, tubes.centre_m),
        )

    def arm(self, work: Array, tip: Array, load: Array, loaded: bool) -> ArmArguments:
        """The arm with a work array, a load at the tip (19,) and a distributed load."""
        return ArmArguments(
            work, self.stiffness, self.rest, self.per_pressure, self.free_per_pa, load, loaded, tip, self.length_m,
            self.scale, self.centre_m,
        )  # fmt: skip

    def work(self) -> Array:
        """A work array for the kernels to write to."""
        work = layout.aligned(len(self.prepared))
        work[:] = self.prepared
        return work

    def tip(self, loads: Loads | None) -> Array:
        """Load at the tip (19,), in the order of `layout.TIP_LOAD`."""
        if loads is None:
            return self.cap
        tip = self.cap.copy()
        tip[:6] += loads.tip()
        tip[13:] += loads.eccentric_force()
        return tip

    def load(self, arm: Arm, loads: Loads | None, nodes: int) -> tuple[Array, bool]:
        """Distributed load at nodes and mid-points (2 N + 1 rows of 6, flat), and whether there is any."""
        if loads is None and not arm.rod_weight:
            return _no_load(nodes), False
        along = np.zeros((2 * nodes + 1, 6)) if loads is None else loads.along(2 * nodes + 1)
        if arm.rod_weight:
            along[:, :3] += arm.line_density_kg_m * np.asarray(arm.gravity_m_s2)
        return along.reshape(-1), bool(along.any())


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
def _no_load(nodes: int) -> Array:
    return np.zeros(6 * (2 * nodes + 1))


def _walls(arm: Arm, branched: bool) -> Walls:
    law = arm.law.tube_law or DEFAULT_TUBE_LAW
    return Walls(arm.law.pointwise, kernel_law(law.name, law.response, branched), arm.geometry.actuators)


@lru_cache(maxsize=64)
def _push_wrench(geometry: Geometry) -> Array:
    """Wrench (6, N) per pascal of each push pressure, about the centroid of the walls."""
    xy = geometry.positions_m - geometry.centroid_m
    return section(geometry, xy, np.zeros(len(xy)), 1.0, 0.0).per_pressure


def _cap(arm: Arm, centre: Array) -> Array:
    tip = np.zeros(layout.TIP_LOAD_SIZE)
    tip[:3] = arm.cap_mass_kg * np.asarray(arm.gravity_m_s2)
    if arm.cap_inertia and arm.inertia:
        tip[6] = arm.cap_mass_kg
        tip[7:10] = arm.cap_inertia_kg_m2
    tip[10:12] = -centre
    return tip


@lru_cache(maxsize=64)
def _prepared(arm: Arm, c0: float, theta: float) -> KernelArguments:
    # Gravity and cap enter the load at the tip only: arms that differ in nothing else share the section.
    nothing = (0.0, 0.0, 0.0)
    shared = _prepared_without_cap(
        replace(arm, gravity_m_s2=nothing, cap_mass_kg=0.0, cap_inertia_kg_m2=nothing), c0, theta
    )
    return replace(shared, cap=_cap(arm, shared.centre_m))


@lru_cache(maxsize=64)
def _prepared_without_cap(arm: Arm, c0: float, theta: float) -> KernelArguments:
    return KernelArguments._build(arm, c0, theta)


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


def _lane(arm: Arm, tubes: _Tubes, whole: CrossSection, c0: float, theta: float) -> Array:
    geometry, material = arm.geometry, arm.material
    # The search for an equilibrium lets any arm move.
    moves = arm.inertia or not c0
    factor = 1 + theta * c0
    blocks = np.empty((4, 3, 3))
    blocks[0], blocks[1] = whole.axial, whole.shear
    blocks[2:] = np.linalg.inv(blocks[:2]) / factor
    blocks[:2] *= theta if arm.law.pointwise else factor
    lane = np.zeros(layout.work_size(geometry.actuators) // layout.LANES)
    lane[layout.C0], lane[layout.LINE_DENSITY] = c0, arm.line_density_kg_m * moves
    lane[layout.INERTIA : layout.LAG] = material.density_kg_m3 * tubes.second_moments_m4 * moves
    lane[layout.LAG] = theta / factor
    lane[layout.AXIAL : layout.OFFSET] = blocks.reshape(4, 9)[:, _UPPER].ravel()
    lane[layout.OFFSET : layout.TUBE] = whole.rest
    lane[layout.TUBE], lane[layout.TUBE + 1] = (
        material.shear_ratio,
        geometry.wall_second_moment_m4 / geometry.wall_area_m2,
    )
    constants = arm.law.constants(material, geometry)
    if len(constants) > layout.LAW_CONSTANTS:
        raise ValueError(
            f"the law {arm.law.name} has {len(constants)} constants, the kernels take {layout.LAW_CONSTANTS}"
        )
    lane[layout.LAW : layout.LAW + len(constants)] = constants
    first = layout.tubes_at(geometry.actuators)
    lane[first : first + tubes.numbers.size] = tubes.numbers.ravel()
    return lane
