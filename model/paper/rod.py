"""The method of the paper, to reproduce it: the neutral axis as the line of the rod, and simple shooting.

Where a printed formula contradicts the others, the default is the one that follows from them; `as_printed` selects the
printed one (docs/explanation/paper.md lists all).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import root

from model.arm import Arm
from model.arrays import Array
from model.errors import NotConverged
from model.loads import Loads
from model.paper.kernels import SAMPLE, STATE, RodArguments, SectionArguments, jacobian, shoot, turn
from model.paper.moduli import frozen_stiffness_n
from model.pressures import pressures
from model.schemes import DEFAULT_ALPHA, DEFAULT_SCHEME, scheme_named
from model.shape import Shape
from model.units import PA_PER_BAR

Erratum = Literal["K12", "weight moment", "stretch as strain"]
RadialEffect = Literal["force", "strain"]
"""How the radial pressure stretches a section (4.4): by the equivalent force of eq 22 on each tube, or by a free strain
of the whole section, the plane through the free strains of the tubes (eq 14)."""


@dataclass(frozen=True)
class NeutralSection:
    """Eqs 18 to 21: the neutral axis D (3,) and the stiffness about it, for one state of pressures."""

    neutral_m: Array
    shear_extension: Array
    bending_torsion: Array
    arms_m: Array
    push_n: Array
    rest_v: Array
    rest_u: Array

    @classmethod
    def of(
        cls,
        arm: Arm,
        pressure_pa: Array,
        modulus_rule: str | None = None,
        rpe_as: RadialEffect = "force",
        as_printed: frozenset[Erratum] = frozenset(),
    ) -> NeutralSection:
        """The section of an arm; modulus_rule as of `moduli.frozen_stiffness_n`."""
        geometry, material = arm.geometry, arm.material
        stiffness = frozen_stiffness_n(arm, pressure_pa, modulus_rule)
        spread = geometry.wall_second_moment_m4 / geometry.wall_area_m2
        neutral = np.append((stiffness[:, None] * geometry.positions_m).sum(axis=0) / stiffness.sum(), 0.0)
        arms = np.column_stack([geometry.positions_m, np.zeros(len(stiffness))]) - neutral
        x, y, _ = arms.T
        shear = material.shear_ratio
        total, own = stiffness.sum(), (stiffness * spread).sum()
        cross = -float((stiffness * x * y).sum())
        if "K12" in as_printed:
            cross = -cross
        bending = np.array(
            [
                [own + (stiffness * y * y).sum(), cross, 0],
                [cross, own + (stiffness * x * x).sum(), 0],
                [0, 0, shear * (stiffness * (x * x + y * y + 2 * spread)).sum()],
            ]
        )
        free = arm.rpe_per_bar * pressure_pa / PA_PER_BAR
        if "stretch as strain" in as_printed and arm.radial_effect:
            free = free + 1.0
        push = arm.actuation.push_pa(pressure_pa) * geometry.chamber_area_m2
        rest_v, rest_u = np.array([0.0, 0.0, 1.0]), np.zeros(3)
        if rpe_as == "force":
            push = push + stiffness * free
        else:
            plane = np.linalg.lstsq(np.column_stack([np.ones(len(x)), y, -x]), free, rcond=None)[0]
            rest_v[2] += plane[0]
            rest_u[:2] = plane[1:]
        return cls(neutral, np.diag([shear * total, shear * total, total]), bending, arms, push, rest_v, rest_u)


class PaperRod:
    """Statics and dynamics by eqs 22 to 29: shooting for the base loads with SciPy's MINPACK.

    modulus_rule: how each E_i is found, as of `moduli.frozen_stiffness_n`. rpe_as: how the radial pressure acts.
    space: 'euler' or 'rk4' with `steps` steps. solver: 'lm' (Levenberg-Marquardt) or 'dogleg' (Powell's hybrid trust
    region). dt_s, scheme, alpha: as for `Dynamics`. as_printed: formulas of the paper to take uncorrected: 'K12'
    (eq 21), 'weight moment' (eq 24), 'stretch as strain' (eq 30 put into eq 22).
    """

    def __init__(
        self,
        arm: Arm,
        dt_s: float = 1 / 30,
        scheme: str = DEFAULT_SCHEME,
        alpha: float = DEFAULT_ALPHA,
        space: Literal["euler", "rk4"] = "rk4",
        steps: int = 50,
        solver: Literal["lm", "dogleg"] = "lm",
        as_printed: frozenset[Erratum] = frozenset(),
        modulus_rule: str | None = None,
        rpe_as: RadialEffect = "force",
    ) -> None:
        if rpe_as not in ("force", "strain"):
            raise ValueError(f"unknown rpe_as {rpe_as!r}: force or strain")
        if space not in ("euler", "rk4"):
            raise ValueError(f"unknown spatial method {space!r}: euler or rk4")
        if solver not in ("lm", "dogleg"):
            raise ValueError(f"unknown solver {solver!r}: lm or dogleg")
        if steps < 1:
            raise ValueError(f"an arm needs at least one step along it, got {steps}")
        self._arm, self._scheme, self._steps = arm, scheme_named(scheme).coefficients(dt_s, alpha), steps
        self._options = {"xtol": 1e-12, "ftol": 1e-14} if solver == "lm" else {"xtol": 1e-11}
        self._euler, self._method, self._as_printed = (
            space == "euler",
            {"lm": "lm", "dogleg": "hybr"}[solver],
            as_printed,
        )
        self._modulus_rule, self._rpe_as = modulus_rule, rpe_as
        self._inertia = _inertia(arm)
        self._states, self._samples = np.empty((steps + 1, STATE)), np.empty((steps + 1, SAMPLE))
        self._guess: Array | None = None
        self._last: Shape | None = None
        self._past = np.zeros((3, steps + 1, SAMPLE))
        self._rate = np.zeros((steps + 1, SAMPLE))

    def statics(self, pressure_pa: ArrayLike, loads: Loads | None = None) -> Shape:
        """The shape at rest under gauge pressures (N,) [Pa]. Raises NotConverged."""
        pressure = pressures(self._arm, pressure_pa)
        known = self._section(pressure)
        # The load at the base is about the push of the pressures.
        guess = np.zeros(6)
        # The first step of MINPACK is proportional to the guess, so the guess must not be zero.
        guess[2] = known.push_n.sum() + 1.0
        guess[3:] = np.cross(known.arms_m, np.outer(known.push_n, [0.0, 0.0, 1.0])).sum(axis=0)
        history = np.zeros((self._steps + 1, SAMPLE))
        if not self._solve(known, guess, history, 0.0, loads):
            raise NotConverged(f"shooting found no equilibrium at {(pressure / PA_PER_BAR).tolist()} bar")
        return self._shape(known, ok=True)

    def start(self, pressure_pa: ArrayLike, loads: Loads | None = None) -> Shape:
        """Start at rest. Raises ValueError for inertia of the cap, viscous walls and friction."""
        if self._arm.cap_inertia or self._arm.material.damping_s > 0 or self._arm.remembers:
            raise ValueError(
                "the paper's formulation has neither the cap's inertia nor viscous walls or friction in motion: "
                "set cap_inertia=False and damping_s=0 without branches and stops, or use model.dynamics.Dynamics"
            )
        shape = self.statics(pressure_pa, loads)
        self._past[:] = self._samples
        self._rate[:] = 0.0
        self._last = shape
        return shape

    def step(self, pressure_pa: ArrayLike, loads: Loads | None = None) -> Shape:
        """Advance by one time step; if shooting fails, the last good shape with ok=False."""
        if self._last is None or self._guess is None:
            raise ValueError("start(pressure_pa) comes before the first step")
        pressure = pressures(self._arm, pressure_pa)
        known = self._section(pressure)
        c = self._scheme
        history = c.c1 * self._past[0] + c.c2 * self._past[1] + c.c3 * self._past[2] + c.d1 * self._rate
        if not self._solve(known, self._guess, history, c.c0, loads):
            return Shape(**{**self._last.__dict__, "ok": False})
        self._past[1:] = self._past[:-1].copy()
        self._past[0] = self._samples
        self._rate = c.c0 * self._samples + history
        self._last = self._shape(known, ok=True)
        return self._last

    def _section(self, pressure: Array) -> NeutralSection:
        return NeutralSection.of(self._arm, pressure, self._modulus_rule, self._rpe_as, self._as_printed)

    def _solve(self, known: NeutralSection, guess: Array, history: Array, c0: float, loads: Loads | None) -> bool:
        arm = self._arm
        loads = loads if loads is not None else Loads()
        if np.any(loads.tip_point_m):
            raise ValueError(
                "the paper's formulation has the tip's force at the end of the axis: leave tip_point_m out"
            )
        load = loads.along(np.linspace(0.0, 1.0, self._steps + 1))
        gravity = np.asarray(arm.gravity_m_s2)
        if arm.rod_weight:
            load[:, :3] += arm.line_density_kg_m * gravity
        tip = np.concatenate([arm.cap_mass_kg * gravity, loads.tip()])
        side = 1.0 if "weight moment" in self._as_printed else -1.0
        section = SectionArguments(
            c0, np.linalg.inv(known.shear_extension), np.linalg.inv(known.bending_torsion), known.rest_v, known.rest_u,
            arm.line_density_kg_m, self._inertia, known.push_n, known.arms_m,
        )  # fmt: skip
        length, weight_arm = arm.geometry.length_m, side * known.neutral_m
        rod = RodArguments(self._euler, self._steps, length, history, load, section, tip, weight_arm)
        fixed = (rod, self._states, self._samples)
        with np.errstate(all="ignore"):
            found = root(shoot, guess, args=fixed, jac=jacobian, method=self._method, options=self._options)
            residual = shoot(found.x, *fixed)
        # MINPACK judges progress only: check the residual.
        if not (np.isfinite(self._states).all() and np.abs(residual).max() < 1e-6):
            return False
        self._guess = found.x
        return True

    def _shape(self, known: NeutralSection, ok: bool) -> Shape:
        """The central axis (eq 29)."""
        n = self._steps + 1
        rotation = np.empty((n, 3, 3))
        for j in range(n):
            turn(self._states[j, 3:7], rotation[j])
        d = known.neutral_m
        p = self._states[:, :3] + d - rotation @ d
        v, u = self._samples[:, :3], self._samples[:, 3:6].copy()
        s = np.linspace(0.0, self._arm.geometry.length_m, n)
        return Shape(s, p, rotation, v - np.cross(u, d), u, ok, self._arm.geometry.positions_m)


def _inertia(arm: Arm) -> Array:
    """rho J (3, 3) [kg m] of the walls about their centroid."""
    area, second = arm.geometry.wall_area_m2, arm.geometry.wall_second_moment_m4
    x, y = (arm.geometry.positions_m - arm.geometry.centroid_m).T
    xx, xy, yy = (area * x * x + second).sum(), (area * x * y).sum(), (area * y * y + second).sum()
    inertia: Array = arm.material.density_kg_m3 * np.array([[yy, -xy, 0.0], [-xy, xx, 0.0], [0.0, 0.0, xx + yy]])
    return inertia
