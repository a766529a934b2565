"""From an arm to the numbers that the kernels work on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model import layout
from model.loads import Loads
from model.section import PA_PER_BAR, Section, section, upper

if TYPE_CHECKING:
    from model.arm import Arm

Array = NDArray[np.float64]

# Last Newton update, in units of `scale`, as `newton` measures it; what is left is its square.
SOLVED = 1e-5
CLOSE = 2.5e-3  # in motion, where the next step corrects


@dataclass(frozen=True)
class Problem:
    """One arm on N + 1 nodes, as the kernels take it. The rod's line runs through the centroid of the walls."""

    law: int
    actuators: int
    work: Array
    rest: Array
    per_pressure: Array
    free_per_pa: float
    centre_m: Array
    length_m: float
    scale: Array

    @classmethod
    def of(cls, arm: Arm, pressure_pa: Array, c0: float = 0.0) -> Problem:
        """Prepare the arm; pressures matter only to the section rules that freeze each modulus."""
        if arm.section_rule in ("linear", "pointwise"):
            known = _prepared(arm, c0)
            work = layout.aligned(len(known.work))
            work[:] = known.work
            return replace(known, work=work)
        return _frozen(arm, c0).at(arm.stiffness_n(pressure_pa))

    @classmethod
    def _build(cls, arm: Arm, pressure_pa: Array, c0: float) -> Problem:
        geometry, material = arm.geometry, arm.material
        centre = geometry.centroid_m
        xy = geometry.positions_m - centre
        pointwise = arm.section_rule == "pointwise"
        whole = section(geometry, xy, arm.stiffness_n(pressure_pa), material.shear_ratio, arm.rpe_per_bar, arm.rpe_as)
        if pointwise:
            # Each tube's own law carries the strain at rest and the free strain; only the push on the caps remains.
            push = section(geometry, xy, np.zeros(len(xy)), material.shear_ratio, 0.0)
            whole = Section(whole.axial, whole.shear, push.rest, push.per_pressure)
        return cls(
            law=layout.POINTWISE if pointwise else layout.LINEAR,
            actuators=len(xy),
            work=_work(arm, xy, whole, c0, pointwise),
            rest=whole.rest,
            per_pressure=whole.per_pressure,
            free_per_pa=arm.rpe_per_bar / PA_PER_BAR,
            centre_m=centre,
            length_m=geometry.length_m,
            scale=_scale(geometry.length_m, c0),
        )

    def tip(self, arm: Arm, loads: Loads | None) -> Array:
        """What hangs on the tip, as `tip_residual` takes it (13,)."""
        tip = np.zeros(13)
        if loads is not None:
            tip[:6] = loads.tip()
        tip[:3] += arm.cap_mass_kg * np.asarray(arm.gravity_m_s2)
        if arm.cap_inertia:
            tip[6] = arm.cap_mass_kg
            tip[7:10] = arm.cap_inertia_kg_m2
        tip[10:12] = -self.centre_m
        return tip

    def load(self, arm: Arm, loads: Loads | None, nodes: int) -> tuple[Array, bool]:
        """Distributed load at nodes and mid-points (2 N + 1 rows of 6, flat), and whether there is any."""
        along = np.zeros((2 * nodes + 1, 6)) if loads is None else loads.along(2 * nodes + 1)
        if arm.rod_weight:
            along[:, :3] += arm.line_density_kg_m * np.asarray(arm.gravity_m_s2)
        return along.reshape(-1), bool(along.any())


@lru_cache(maxsize=64)
def _prepared(arm: Arm, c0: float) -> Problem:
    return Problem._build(arm, np.zeros(arm.geometry.actuators), c0)


@dataclass(frozen=True)
class _Frozen:
    """An arm whose rule freezes each modulus. Its section is linear in the tubes' stiffness, and that alone changes.

    without (m,), each (N, m): axial and shear block, rest and per_pressure, flat, of no tube and per N of each tube.
    """

    problem: Problem
    grown: float
    without: Array
    each: Array

    def at(self, stiffness_n: Array) -> Problem:
        """The arm at axial stiffnesses (N,) of its tubes."""
        parts = self.without + stiffness_n @ self.each
        blocks = parts[:18].reshape(2, 3, 3)
        turned = np.concatenate([blocks * self.grown, np.linalg.inv(blocks) / self.grown])
        work = layout.aligned(len(self.problem.work))
        work[:] = self.problem.work
        rows = work.reshape(-1, layout.LANES)
        rows[layout.AXIAL : layout.OFFSET] = turned.reshape(4, 9)[:, _UPPER].reshape(-1, 1)
        rows[layout.OFFSET : layout.OFFSET + 6] = parts[18:24, None]
        return replace(self.problem, work=work, rest=parts[18:24], per_pressure=parts[24:].reshape(6, -1))


_UPPER = upper(np.arange(9).reshape(3, 3))


@lru_cache(maxsize=64)
def _frozen(arm: Arm, c0: float) -> _Frozen:
    geometry, material = arm.geometry, arm.material
    count = geometry.actuators

    def flat(stiffness_n: Array) -> Array:
        xy = geometry.positions_m - geometry.centroid_m
        one = section(geometry, xy, stiffness_n, material.shear_ratio, arm.rpe_per_bar, arm.rpe_as)
        return np.concatenate([part.ravel() for part in (one.axial, one.shear, one.rest, one.per_pressure)])

    without = flat(np.zeros(count))
    each = np.array([flat(one) - without for one in np.eye(count)])
    return _Frozen(Problem._build(arm, np.zeros(count), c0), 1 + material.damping_s * c0, without, each)


def pressures(arm: Arm, pressure_pa: ArrayLike) -> Array:
    """The pressures as an array (N,), or ValueError when they are not N finite numbers."""
    pressure = np.array(pressure_pa, dtype=np.float64)
    if pressure.shape != (arm.geometry.actuators,):
        raise ValueError(f"pressure_pa must hold {arm.geometry.actuators} numbers, got shape {pressure.shape}")
    if not np.isfinite(pressure).all():
        raise ValueError(f"pressures must be finite, got {pressure.tolist()} Pa")
    return pressure


def _scale(length_m: float, c0: float) -> Array:
    """What counts as a change of order one in (v, u, q, w, h), then the reciprocals (32,).

    A velocity counts by how far it carries in a step.
    """
    one, bent = np.ones(3), np.full(3, 1 / length_m)
    carried = max(1.0, 0.25 * c0 * length_m)
    scale = np.concatenate([one, bent, carried * one, carried * bent, np.ones(4)])
    return np.concatenate([scale, 1 / scale])


def _work(arm: Arm, xy: Array, whole: Section, c0: float, pointwise: bool) -> Array:
    work = layout.aligned(layout.work_size(len(xy)) // layout.LANES, layout.LANES)
    geometry, material = arm.geometry, arm.material
    area, second = geometry.wall_area_m2, geometry.wall_second_moment_m4
    x, y = xy.T
    xx, yy, xys = (area * x * x + second).sum(), (area * y * y + second).sum(), (area * x * y).sum()
    inertia = material.density_kg_m3 * np.array([yy, xx, -xys, xx + yy])
    tube = [material.a1_per_n, material.a2_per_n2, material.shear_ratio, second / area]
    tau = material.damping_s
    grown = 1 + tau * c0
    share = tau if pointwise else grown
    parameters = [
        c0,
        arm.line_density_kg_m,
        *inertia,
        tau / grown,
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
        work[at : at + layout.PER_TUBE] = np.array([cx, cy, 0.0, 1.0])[:, None]
    return work.reshape(-1)
