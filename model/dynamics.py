"""The arm in motion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model.axis import motion
from model.layout import STATE, aligned
from model.loads import Loads
from model.march import advance, settle
from model.problem import CLOSE, Problem, pressures
from model.schemes import Scheme
from model.shape import Shape
from model.shooting import Room
from model.statics import shape, states

if TYPE_CHECKING:
    from model.arm import Arm

Array = NDArray[np.float64]
NOT_FINITE = "pressures must be finite"


@dataclass(frozen=True)
class Motion:
    """The tip over T time steps: tip_m (T, 3), tip_rotation (T, 3, 3), ok (T,)."""

    tip_m: Array
    tip_rotation: Array
    ok: NDArray[np.bool_]


class Dynamics:
    """Steps one arm through time; made by `Arm.dynamics`."""

    def __init__(self, arm: Arm, dt_s: float, scheme: str, alpha: float, nodes: int | None) -> None:
        self._scheme = Scheme.named(scheme, dt_s, alpha)
        self._arm = arm
        growth = self._growth()
        self._nodes = nodes if nodes is not None else 4 * max(3, math.ceil(growth / 2))
        if self._nodes < 2:
            raise ValueError(f"an arm needs at least two steps along it, got {nodes}")
        if self._nodes < growth:
            raise ValueError(
                f"a time step of {dt_s} s needs at least {math.ceil(growth)} steps along the arm, got {nodes}"
            )
        self._segments = _segments(self._nodes, growth)
        self._coefficients = np.array(
            [self._scheme.c0, self._scheme.c1, self._scheme.c2, self._scheme.c3, self._scheme.d1]
        )
        self._started = False

    @property
    def nodes(self) -> int:
        """Steps along the arm."""
        return self._nodes

    @property
    def segments(self) -> int:
        """Into how many parts the arm is cut."""
        return self._segments

    @property
    def c0(self) -> float:
        """Of the time scheme (eq 26) [1/s]."""
        return self._scheme.c0

    def arguments(self) -> tuple[Any, ...]:
        """The arm in motion, after `start`, as `moving.moving` takes it."""
        problem = self._problem
        return (
            problem.work, problem.law, problem.actuators, problem.rest, problem.per_pressure, problem.free_per_pa,
            self._before, self._load, self._loaded, problem.length_m, self._segments, problem.scale,
            self._coefficients, self._trail, self._x, self._room, CLOSE, problem.centre_m,
        )  # fmt: skip

    def start(self, pressure_pa: ArrayLike, loads: Loads | None = None) -> Shape:
        """Begin at rest under gauge pressures (N,) [Pa]; raises as `Arm.statics` does."""
        pressure = pressures(self._arm, pressure_pa)
        n = self._nodes
        resting = Problem.of(self._arm, pressure)
        self._x = states(self._arm, resting, pressure, loads, n)
        self._problem = Problem.of(self._arm, pressure, self._scheme.c0)
        self._room = Room.of(n)
        self._trail = aligned(2, 2 * n + 2, STATE)
        settle(self._coefficients, self._x, self._trail, resting.length_m, self._room)
        self._before = np.stack([pressure] * 3)
        self._set_loads(loads)
        self._started = True
        return shape(self._arm, self._problem, self._x, ok=True)

    def step(self, pressure_pa: ArrayLike, loads: Loads | None = None) -> Shape:
        """Advance by one time step under gauge pressures (N,) [Pa], held at the step's end.

        Where the step cannot be solved, the shape is the last good one with ok=False, and the next step goes on from
        it. Raises ValueError for pressures or loads that are not finite or of the wrong shape.
        """
        if not self._started:
            raise ValueError("start(pressure_pa) comes before the first step")
        pressure = pressures(self._arm, pressure_pa)
        if loads is not self._loads:
            self._set_loads(loads)
        if self._arm.section_rule not in ("linear", "pointwise"):
            self._problem = Problem.of(self._arm, pressure, self._scheme.c0)
        problem = self._problem
        passes = advance(
            problem.work, problem.law, problem.actuators, problem.rest, problem.per_pressure, problem.free_per_pa,
            self._before, pressure, self._load, self._loaded, self._tip, problem.length_m, self._segments,
            problem.scale, self._coefficients, self._trail, self._x, self._room, CLOSE,
        )  # fmt: skip
        return shape(self._arm, problem, self._x, ok=passes > 0)

    def run(self, pressure_pa: ArrayLike) -> Motion:
        """Advance through the rows of pressure_pa (T, N) [Pa] in one call, with the loads of the last step.

        What `step` does T times, without Python in between; a step that cannot be solved keeps the last good tip and
        has ok False. Raises as `step` does.
        """
        if not self._started:
            raise ValueError("start(pressure_pa) comes before the first step")
        rows = np.array(pressure_pa, dtype=np.float64)
        actuators = self._arm.geometry.actuators
        if rows.ndim != 2 or rows.shape[1] != actuators:
            raise ValueError(f"pressure_pa must be rows of {actuators} numbers, got shape {rows.shape}")
        if self._arm.section_rule not in ("linear", "pointwise"):
            if not np.isfinite(rows).all():
                raise ValueError(NOT_FINITE)
            shapes = [self.step(row) for row in rows]
            return Motion(
                np.array([shape.tip_m for shape in shapes]).reshape(-1, 3),
                np.array([shape.tip_rotation for shape in shapes]).reshape(-1, 3, 3),
                np.array([shape.ok for shape in shapes], dtype=bool),
            )
        problem, count = self._problem, len(rows)
        tips, turns, good = np.empty((count, 3)), np.empty((count, 3, 3)), np.empty(count, dtype=np.bool_)
        passes = motion(
            problem.work, problem.law, problem.actuators, problem.rest, problem.per_pressure, problem.free_per_pa,
            self._before, rows, self._load, self._loaded, self._tip, problem.length_m, self._segments,
            problem.scale, self._coefficients, self._trail, self._x, self._room, CLOSE,
            problem.centre_m, tips, turns, good,
        )  # fmt: skip
        if passes < 0:
            raise ValueError(NOT_FINITE)
        return Motion(tips, turns, good)

    def _set_loads(self, loads: Loads | None) -> None:
        self._loads = loads
        self._tip = self._problem.tip(self._arm, loads)
        self._load, self._loaded = self._problem.load(self._arm, loads, self._nodes)

    def _growth(self) -> float:
        """Exponent by which the stiffest mode grows along the arm within one time step's equations, c0 L / c_shear."""
        material, geometry = self._arm.material, self._arm.geometry
        stiffness = float(self._arm.stiffness_n(np.zeros(geometry.actuators)).min())
        if self._arm.section_rule != "linear":
            # A tube that follows eq 32 is about half as stiff at the paper's highest pressure.
            stiffness *= 0.5
        slowest = math.sqrt(material.shear_ratio * stiffness / (material.density_kg_m3 * geometry.wall_area_m2))
        return self._scheme.c0 * geometry.length_m / slowest


def _segments(nodes: int, growth: float) -> int:
    """The smallest divisor of `nodes` that keeps the growth within one segment harmless."""
    if growth < 2.5:
        return 1
    wanted = min(nodes, max(1, math.ceil(growth / 2)))
    return next(d for d in range(wanted, nodes + 1) if nodes % d == 0)
