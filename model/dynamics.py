"""Time integration of an arm in motion."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model.arm import Arm
from model.arrays import Array
from model.errors import Unstable
from model.hysteresis import Hysteresis
from model.kernel_arguments import KernelArguments
from model.kernels.arguments import ArmArguments, MotionState
from model.kernels.axis import motion
from model.kernels.layout import STATE, aligned
from model.kernels.relaxation import update_midpoints, update_past_strains
from model.kernels.shooting import TOLERANCE_IN_MOTION, workspace_in, workspace_size
from model.kernels.time_stepping import initialise_history
from model.loads import Loads
from model.pressures import pressures
from model.schemes import DEFAULT_ALPHA, DEFAULT_SCHEME, Coefficients, scheme_named
from model.shape import Shape
from model.statics import MOST_NODES, shape, states, steps_along
from model.viscoelasticity import branch_factors

NOT_FINITE = "pressures must be finite"


@dataclass(frozen=True)
class ArmTrajectory:
    """The tip over T time steps: tip_m (T, 3), tip_rotation (T, 3, 3), ok (T,)."""

    tip_m: Array
    tip_rotation: Array
    ok: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class SavedMotion:
    """Copies of all arrays that the time steps of one `Dynamics` change."""

    arrays: tuple[Array, ...]


class Dynamics:
    """Time integrator of one arm, by default with a fixed time step [s].

    scheme, alpha: a scheme of `model/schemes.py`. nodes: steps along the arm; by default as many as the time step and
    a slender arm need. ValueError for fewer than can follow the waves of so short a step, an unknown scheme, or a time
    step that is not positive.
    """

    def __init__(
        self,
        arm: Arm,
        dt_s: float,
        scheme: str = DEFAULT_SCHEME,
        alpha: float = DEFAULT_ALPHA,
        nodes: int | None = None,
    ) -> None:
        self._scheme, self._alpha, self._dt_s = scheme_named(scheme), alpha, dt_s
        self._coefficients = self._scheme.coefficients(dt_s, alpha)
        self._arm = arm
        growth = self._growth()
        if not growth < MOST_NODES / 2:
            raise ValueError(f"a time step of {dt_s} s is too short for this arm: it needs {growth:.3g} steps along it")
        slender = 1.5 * arm.slenderness
        if nodes is None and arm.inertia:
            nodes = 4 * math.ceil(max(3, growth / 2, slender))
        self._nodes = steps_along(arm, nodes)
        if self._nodes < growth:
            raise ValueError(
                f"a time step of {dt_s} s needs at least {math.ceil(growth)} steps along the arm, got {nodes}"
            )
        self._even_growth = growth
        self._segments = _segments(self._nodes, growth, len(arm.segments))
        self._even = self._coefficients
        self._coefficient_array = _array(self._coefficients)
        self._started = False
        self._loads: Loads | None = None

    @property
    def nodes(self) -> int:
        """Steps along the arm."""
        return self._nodes

    @property
    def segments(self) -> int:
        """Number of shooting segments along the arm."""
        return self._segments

    @property
    def c0(self) -> float:
        """Coefficient c0 of the time scheme (eq 26) [1/s]."""
        return self._coefficients.c0

    @property
    def shortest_step_s(self) -> float:
        """The shortest time step for which the steps along the arm resolve the waves."""
        return self._dt_s * self._even_growth / self._nodes

    @property
    def state(self) -> MotionState:
        """Pressures, solutions and coefficients for the next time step, as arguments of the kernels; after `start`."""
        return self._state

    @property
    def arm_with_cap(self) -> ArmArguments:
        """The arm in motion without tip loads beyond its cap, as arguments of the kernels; after `start`."""
        return self._arguments.arm(self._work, self._arguments.ends, self._load, self._loaded, self._first)

    @property
    def pool(self) -> Array:
        """The array that holds the solver's workspace; after `start`."""
        return self._pool

    def start(self, pressure_pa: ArrayLike, loads: Loads | None = None) -> Shape:
        """Start at rest under gauge pressures (N,) [Pa]; raises as `statics` does."""
        pressure = pressures(self._arm, pressure_pa)
        at_rest = KernelArguments.of(self._arm, pressure[None])
        load, loaded = at_rest.load(self._arm, loads, at_rest.first_nodes(self._nodes))
        self.start_from(at_rest, pressure, at_rest.ends_with(loads), load, loaded)
        self._loads = loads
        return shape(self._arm, self._arguments, self._x, self._first, ok=True, stable=True)

    def start_from(self, at_rest: KernelArguments, pressure: Array, ends: Array, load: Array, loaded: bool) -> None:
        """Start at rest as `start` does, from the arguments of the static solution; ends, load: of `ArmArguments`."""
        n = self._nodes
        self._first = at_rest.first_nodes(n)
        self._last_s, self._step_s, self._coefficients_last_s = self._dt_s, self._dt_s, self._dt_s
        self._coefficients, self._segments = self._even, _segments(n, self._even_growth, len(self._arm.segments))
        self._coefficient_array = _array(self._coefficients)
        self._x, stable = states(at_rest, pressure, ends, load, loaded, self._first)
        if not stable:
            raise Unstable.at(pressure)
        self._arguments = KernelArguments.of(self._arm, pressure[None], self._coefficients.c0, self._dt_s)
        self._work = self._arguments.work()
        branches = self._arm.branches
        self._line = at_rest.line(self._first)
        self._pool = aligned(workspace_size(n, branches))
        self._workspace = workspace_in(self._pool, n, branches)
        self._past_states = aligned(2, 2 * n + 2, STATE)
        initialise_history(self._coefficient_array, self._x, self._past_states, self._line, self._workspace)
        self._hysteresis = Hysteresis(self._arm.actuation.stops, pressure)
        self._branch_strains = np.zeros((branches, 2 * n + 2, 6))
        self._branch_factors = branch_factors(self._arm, self._coefficients.c0, self._dt_s)
        self._compute_past_strains()
        self._last_pressures = np.stack([pressure] * 3)
        self._loads, self._ends, self._load, self._loaded = None, ends, load, loaded
        self._prepare()
        self._started = True

    def step(self, pressure_pa: ArrayLike, loads: Loads | None = None, dt_s: float | None = None) -> Shape:
        """Advance by one time step under gauge pressures (N,) [Pa], held at the step's end.

        dt_s: length of this step [s]; default: that of the constructor. Steps may vary, with the order of the scheme;
        ValueError for one shorter than `shortest_step_s`, and for a scheme of fixed steps.
        Without a solution, the shape is the last good one with ok=False, and the next step continues from it. Raises
        ValueError for pressures or loads that are not finite or of the wrong shape.
        """
        if not self._started:
            raise ValueError("start(pressure_pa) comes before the first step")
        pressure = pressures(self._arm, pressure_pa)
        if loads is not self._loads:
            self._set_loads(loads)
        dt_s = self._dt_s if dt_s is None else dt_s
        self._change_step(dt_s)
        moved = self._advance(self._hysteresis.advance(pressure[None]))
        if moved.ok[0]:
            self._last_s = dt_s
        return shape(self._arm, self._arguments, self._x, self._first, ok=bool(moved.ok[0]))

    def run(self, pressure_pa: ArrayLike) -> ArmTrajectory:
        """Advance through the rows of pressure_pa (T, N) [Pa] in one call, with the loads of the last step.

        Equal to T calls of `step`; a time step without a solution keeps the last good tip and has ok False. Raises as
        `step` does.
        """
        if not self._started:
            raise ValueError("start(pressure_pa) comes before the first step")
        rows = np.array(pressure_pa, dtype=np.float64)
        actuators = self._arm.actuators
        if rows.ndim != 2 or rows.shape[1] != actuators:
            raise ValueError(f"pressure_pa must be rows of {actuators} numbers, got shape {rows.shape}")
        if self._last_s != self._dt_s:
            raise ValueError("run continues steps of the constructor's length only: the last one had another")
        self._change_step(self._dt_s)
        # The kernel checks the pressures at less cost, but these laws compute with them before.
        if (self._arm.by_pressure or self._arm.actuation.stops) and not np.isfinite(rows).all():
            raise ValueError(NOT_FINITE)
        return self._advance(self._hysteresis.advance(rows))

    def saved(self) -> SavedMotion:
        """The motion after the last step, for `restore`; the steps so far have the constructor's length."""
        return SavedMotion(tuple(array.copy() for array in self._changing()))

    def restore(self, motion: SavedMotion) -> None:
        """Continue from a motion that this object has saved since its last start."""
        for array, value in zip(self._changing(), motion.arrays, strict=True):
            array[...] = value

    def _changing(self) -> tuple[Array, ...]:
        own = (self._x, self._past_states, self._last_pressures, self._branch_strains, self._pool)
        return *own, *self._hysteresis.state

    def _change_step(self, dt_s: float) -> None:
        """Prepare a time step of another length: its coefficients, and its history y^h (eq 26).

        The weight d1 of the rate y_t of the last step does not depend on the length of a step.
        """
        if dt_s == self._step_s and self._last_s == self._coefficients_last_s:
            return
        coefficients = self._scheme.varying_coefficients(dt_s, self._last_s, self._alpha)
        if coefficients == self._coefficients:
            return
        if dt_s < self.shortest_step_s:
            raise ValueError(f"a time step of {dt_s} s is shorter than {self.shortest_step_s:.3g} s")
        growth = self._even_growth * coefficients.c0 / self._even.c0
        self._segments = _segments(self._nodes, growth, len(self._arm.segments))
        last = self._coefficients
        size, history = self._x.size, self._workspace.history
        for weight, past in (
            (coefficients.c1 - last.c1, self._x),
            (coefficients.c2 - last.c2, self._past_states[0]),
            (coefficients.c3 - last.c3, self._past_states[1]),
        ):
            history[:size] += weight * past.ravel()
        update_midpoints(history, size // 2, self._line)
        self._coefficients, self._coefficient_array = coefficients, _array(coefficients)
        self._step_s, self._coefficients_last_s = dt_s, self._last_s
        self._branch_factors = branch_factors(self._arm, coefficients.c0, dt_s)
        self._compute_past_strains()
        self._arguments = KernelArguments.of(self._arm, self._last_pressures[:1], coefficients.c0, dt_s)
        self._work = self._arguments.work()
        self._prepare()

    def _prepare(self) -> None:
        """Collect the arguments of the kernels, which most time steps share."""
        self._arm_fields = tuple(self._arguments.arm(self._work, self._ends, self._load, self._loaded, self._first))
        self._state = MotionState(
            self._last_pressures, self._segments, self._coefficient_array, self._past_states, self._x,
            self._branch_factors, self._branch_strains,
        )  # fmt: skip
        self._state_fields = tuple(self._state)

    def _compute_past_strains(self) -> None:
        """Past strains of the walls for the next step, if they differ from the history."""
        if len(self._branch_strains):
            past = self._workspace.walls_past
            history = self._workspace.history
            update_past_strains(self._line, self._branch_factors, self._branch_strains, self._x, history, past)

    def _advance(self, rows: Array) -> ArmTrajectory:
        if self._arm.by_pressure and len(rows):
            self._arguments = KernelArguments.of(self._arm, rows, self._coefficients.c0, self._step_s)
            self._work = self._arguments.work()
            self._prepare()
        count = len(rows)
        tips = np.empty((count, 3)), np.empty((count, 3, 3)), np.empty(count, dtype=np.bool_)
        passes = motion(
            self._arguments.walls, self._arm_fields, self._state_fields, rows, self._pool, TOLERANCE_IN_MOTION, tips
        )
        if passes < 0:
            raise ValueError(NOT_FINITE)
        return ArmTrajectory(*tips)

    def _set_loads(self, loads: Loads | None) -> None:
        self._ends = self._arguments.ends_with(loads)
        self._load, self._loaded = self._arguments.load(self._arm, loads, self._first)
        self._loads = loads
        self._prepare()

    def _growth(self) -> float:
        """Exponent c0 L / c_shear of the stiffest mode, which grows along the arm in the equations of one time step."""
        if not self._arm.inertia:
            return 0.0
        growth = 0.0
        for segment in self._arm.segments:
            material, geometry = segment.material, segment.geometry
            stiffness = segment.law.softest * segment.stiffness_n
            slowest = math.sqrt(material.shear_ratio * stiffness / (material.density_kg_m3 * geometry.wall_area_m2))
            growth += self._coefficients.c0 * geometry.length_m / slowest
        return growth


def _array(coefficients: Coefficients) -> Array:
    c = coefficients
    return np.array([c.c0, c.c1, c.c2, c.c3, c.d1])


def _segments(nodes: int, growth: float, least: int) -> int:
    """The smallest divisor of `nodes` that limits the growth within one shooting segment, and is at least `least`."""
    if growth >= 2.5:
        least = max(least, math.ceil(growth / 2))
    return next(d for d in range(min(nodes, least), nodes + 1) if nodes % d == 0)
