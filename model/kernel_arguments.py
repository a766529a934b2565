"""From an arm to the numbers that the kernels work on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from model.actuation import PA_PER_BAR
from model.arm import Arm
from model.geometry import Geometry
from model.kernels import layout
from model.kernels.arguments import ArmArguments
from model.kernels.law import Walls, kernel_law
from model.loads import Loads
from model.section import CrossSection, section, upper
from model.variants import DEFAULT_TUBE_LAW
from model.viscoelasticity import viscous_time_s

Array = NDArray[np.float64]


@dataclass(frozen=True)
class KernelArguments:
    """One arm on N + 1 nodes, as the kernels take it. The rod's line runs through the centroid of the walls.

    stiffness (R, 24), per_pressure (R, 6, N): sections, one for each row of pressures where their rule freezes the
    moduli, else one for all. rest (Q, 6): the wrench at zero strain, without the part in proportion to the pressures;
    one for each row where the rule freezes the moduli or the push grows. prepared: a work array with the first section
    in it. cap (19,): what the arm itself hangs on the tip, as it stands at `layout.END`. Problems are shared, so the
    kernels take a copy of the work array, and the others are never written.
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
        """Prepare the arm, at rest or in time steps of dt_s [s] of a scheme with c0.

        Pressures (R, N) matter only to an arm whose sections differ `by_pressure`.
        """
        theta = viscous_time_s(arm.material, c0, dt_s)
        prepared = _prepared(arm, c0, theta)
        if arm.law.frozen:
            stiffness, rest, per_pressure = _frozen(arm, c0, theta).at(arm.stiffness_n(pressure_pa))
            work = prepared.prepared.copy()
            work.reshape(-1, layout.LANES)[layout.AXIAL : layout.OFFSET] = stiffness[0, :, None]
            prepared = replace(prepared, prepared=work, stiffness=stiffness, rest=rest, per_pressure=per_pressure)
        if arm.actuation.grows:
            beyond = arm.actuation.push_pa(pressure_pa) - pressure_pa
            # No matrix product: its rounding depends on the number of rows.
            wrench = (beyond[:, None, :] * _push_wrench(arm.geometry)).sum(axis=2)
            prepared = replace(prepared, rest=prepared.rest + wrench)
        return prepared

    @classmethod
    def _build(cls, arm: Arm, c0: float, theta: float) -> KernelArguments:
        geometry, material = arm.geometry, arm.material
        centre = geometry.centroid_m
        xy = geometry.positions_m - centre
        pointwise = arm.law.pointwise
        stiffness_n = arm.stiffness_n(np.zeros(len(xy)))
        whole = section(geometry, xy, stiffness_n, material.shear_ratio, arm.rpe_per_bar, arm.rpe_as)
        if pointwise:
            # Each tube's own law carries the strain at rest and the free strain; only the push on the caps remains.
            whole = CrossSection(whole.axial, whole.shear, np.zeros(6), _push_wrench(geometry))
        work = _work(arm, xy, whole, c0, theta, pointwise)
        return cls(
            # At rest branches carry nothing.
            walls=_walls(arm, branched=bool(arm.material.branches) and c0 > 0),
            prepared=work,
            stiffness=work.reshape(-1, layout.LANES)[None, layout.AXIAL : layout.OFFSET, 0].copy(),
            rest=whole.rest[None],
            per_pressure=whole.per_pressure[None],
            free_per_pa=arm.rpe_per_bar / PA_PER_BAR,
            centre_m=centre,
            length_m=geometry.length_m,
            scale=_scale(geometry.length_m, c0),
            cap=_cap(arm, centre),
        )

    def arm(self, work: Array, tip: Array, load: Array, loaded: bool) -> ArmArguments:
        """The arm with a work array, the wrench on its tip and its distributed load, as the outer kernels take it."""
        return ArmArguments(
            work, self.stiffness, self.rest, self.per_pressure, self.free_per_pa, load, loaded, tip, self.length_m,
            self.scale, self.centre_m,
        )  # fmt: skip

    def work(self) -> Array:
        """A work array of one's own."""
        work = layout.aligned(len(self.prepared))
        work[:] = self.prepared
        return work

    def tip(self, loads: Loads | None) -> Array:
        """What hangs on the tip, as it stands at `layout.END` (19,)."""
        if loads is None:
            return self.cap
        tip = self.cap.copy()
        tip[:6] += loads.tip()
        tip[13:] += loads.pull()
        return tip

    def load(self, arm: Arm, loads: Loads | None, nodes: int) -> tuple[Array, bool]:
        """Distributed load at nodes and mid-points (2 N + 1 rows of 6, flat), and whether there is any."""
        if loads is None and not arm.rod_weight:
            return _no_load(nodes), False
        along = np.zeros((2 * nodes + 1, 6)) if loads is None else loads.along(2 * nodes + 1)
        if arm.rod_weight:
            along[:, :3] += arm.line_density_kg_m * np.asarray(arm.gravity_m_s2)
        return along.reshape(-1), bool(along.any())


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
    tip = np.zeros(layout.HANGS)
    tip[:3] = arm.cap_mass_kg * np.asarray(arm.gravity_m_s2)
    if arm.cap_inertia and arm.inertia:
        tip[6] = arm.cap_mass_kg
        tip[7:10] = arm.cap_inertia_kg_m2
    tip[10:12] = -centre
    return tip


@lru_cache(maxsize=64)
def _prepared(arm: Arm, c0: float, theta: float) -> KernelArguments:
    return KernelArguments._build(arm, c0, theta)


@dataclass(frozen=True)
class _Frozen:
    """An arm whose rule freezes each modulus. Its section is linear in the tubes' stiffness, and that alone changes.

    without (m,), each (N, m): axial and shear block, rest and per_pressure, flat, of no tube and per N of each tube.
    """

    grown: float
    without: Array
    each: Array

    def at(self, stiffness_n: Array) -> tuple[Array, Array, Array]:
        """Sections (R, 24), (R, 6), (R, 6, N), as of `KernelArguments`, at axial stiffnesses (R, N) of the tubes."""
        # No matrix product: its rounding depends on the number of rows.
        parts = self.without + (stiffness_n[:, :, None] * self.each).sum(axis=1)
        rows = len(parts)
        blocks = parts[:, :18].reshape(rows, 2, 3, 3)
        turned = np.concatenate([blocks * self.grown, np.linalg.inv(blocks) / self.grown], axis=1)
        stiffness = turned.reshape(rows, 4, 9)[:, :, _UPPER].reshape(rows, 24)
        return stiffness, parts[:, 18:24].copy(), parts[:, 24:].copy().reshape(rows, 6, -1)


_UPPER = upper(np.arange(9).reshape(3, 3))


@lru_cache(maxsize=64)
def _frozen(arm: Arm, c0: float, theta: float) -> _Frozen:
    geometry, material = arm.geometry, arm.material
    xy = geometry.positions_m - geometry.centroid_m

    def flat(stiffness_n: Array) -> Array:
        one = section(geometry, xy, stiffness_n, material.shear_ratio, arm.rpe_per_bar, arm.rpe_as)
        return np.concatenate([part.ravel() for part in (one.axial, one.shear, one.rest, one.per_pressure)])

    without = flat(np.zeros(len(xy)))
    each = np.array([flat(one) - without for one in np.eye(len(xy))])
    return _Frozen(1 + theta * c0, without, each)


def _scale(length_m: float, c0: float) -> Array:
    """What counts as a change of order one in (v, u, q, w, h), then the reciprocals (32,).

    A velocity counts by how far it carries in a step.
    """
    one, bent = np.ones(3), np.full(3, 1 / length_m)
    carried = max(1.0, 0.25 * c0 * length_m)
    scale = np.concatenate([one, bent, carried * one, carried * bent, np.ones(4)])
    return np.concatenate([scale, 1 / scale])


def _law_constants(arm: Arm) -> list[float]:
    constants = arm.law.constants(arm.material, arm.geometry)
    if len(constants) > layout.LAW_CONSTANTS:
        raise ValueError(
            f"the law {arm.law.name} has {len(constants)} constants, the kernels take {layout.LAW_CONSTANTS}"
        )
    return [*constants, *[0.0] * (layout.LAW_CONSTANTS - len(constants))]


def _work(arm: Arm, xy: Array, whole: CrossSection, c0: float, theta: float, pointwise: bool) -> Array:
    work = layout.aligned(layout.work_size(len(xy)) // layout.LANES, layout.LANES)
    geometry, material = arm.geometry, arm.material
    area, second = geometry.wall_area_m2, geometry.wall_second_moment_m4
    x, y = xy.T
    xx, yy, xys = (area * x * x + second).sum(), (area * y * y + second).sum(), (area * x * y).sum()
    # The search for an equilibrium lets any arm swing.
    swings = arm.inertia or not c0
    inertia = material.density_kg_m3 * np.array([yy, xx, -xys, xx + yy]) * swings
    tube = [material.shear_ratio, second / area, *_law_constants(arm)]
    grown = 1 + theta * c0
    share = theta if pointwise else grown
    parameters = [
        c0,
        arm.line_density_kg_m * swings,
        *inertia,
        theta / grown,
        *upper(whole.axial * share),
        *upper(whole.shear * share),
        *upper(np.linalg.inv(whole.axial) / grown),
        *upper(np.linalg.inv(whole.shear) / grown),
        *whole.rest,
        *tube,
    ]
    work[layout.C0 : layout.TRIO] = np.array(parameters)[:, None]
    for k, (cx, cy) in enumerate(xy):
        at = layout.tubes_at(len(xy)) + layout.PER_TUBE * k
        place = [cx, cy, 0.0, 1.0, cx * cx, cx * cy, cy * cy, cx * cx + cy * cy + 2.0 * second / area]
        work[at : at + layout.PER_TUBE] = np.array(place)[:, None]
    return work.reshape(-1)
