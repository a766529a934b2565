"""The arm in motion."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model.arm import Arm
from model.errors import Unstable
from model.hysteresis import Hysteresis
from model.kernel_arguments import KernelArguments
from model.kernels.arguments import ArmArguments, MotionState, TipPoses
from model.kernels.axis import motion
from model.kernels.layout import STATE, aligned
from model.kernels.relaxation import recall_branches
from model.kernels.shooting import TOLERANCE_IN_MOTION, Workspace, workspace_in, workspace_size
from model.kernels.time_stepping import initialise_history
from model.loads import Loads
from model.pressures import pressures
from model.schemes import DEFAULT_ALPHA, Coefficients, scheme_named
from model.shape import Shape
from model.statics import MOST_NODES, shape, states, steps_along
from model.viscoelasticity import branch_factors

Array = NDArray[np.float64]
NOT_FINITE = "pressures must be finite"


@dataclass(frozen=True)
class ArmTrajectory:
    """The tip over T time steps: tip_m (T, 3), tip_rotation (T, 3, 3), ok (T,)."""

    tip_m: Array
    tip_rotation: Array
    ok: NDArray[np.bool_]


class Dynamics:
    """A stepper of one arm through time, by default with a fixed step [s].

    scheme, alpha: a scheme of Table 2 (model/schemes.py). nodes: steps along the arm; by default as many as the time
    step and a slender arm need. ValueError for fewer than can follow the waves of so short a step, an unknown scheme,
    or a time step that is not positive.
    """

    def __init__(
        self, arm: Arm, dt_s: float, scheme: str = "bdf-alpha", alpha: float = DEFAULT_ALPHA, nodes: int | None = None
    ) -> None:
        self._rule, self._alpha, self._dt_s = scheme_named(scheme), alpha, dt_s
        self._scheme = self._rule.coefficients(dt_s, alpha)
        self._arm = arm
        growth = self._growth()
        if not growth < MOST_NODES / 2:
            raise ValueError(f"a time step of {dt_s} s is too short for this arm: it needs {growth:.3g} steps along it")
        slender = 1.5 * arm.geometry.slenderness
        if nodes is None and arm.inertia:
            nodes = 4 * math.ceil(max(3, growth / 2, slender))
        self._nodes = steps_along(arm, nodes)
        if self._nodes < growth:
            raise ValueError(
                f"a time step of {dt_s} s needs at least {math.ceil(growth)} steps along the arm, got {nodes}"
            )
        self._even_growth = growth
        self._segments = _segments(self._nodes, growth)
        self._even = self._scheme
        self._coefficients = _array(self._scheme)
        self._started = False
        self._loads: Loads | None = None

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

    @property
    def shortest_step_s(self) -> float:
        """The shortest time step whose waves the steps along the arm follow."""
        return self._dt_s * self._even_growth / self._nodes

    @property
    def state(self) -> MotionState:
        """Where the motion stands, as the kernels take it; after `start`."""
        return self._state

    @property
    def arm_with_cap(self) -> ArmArguments:
        """The arm in motion with nothing on its tip but the cap, as the kernels take it; after `start`."""
        return self._problem.arm(self._work, self._problem.cap, self._load, self._loaded)

    @property
    def workspace(self) -> Workspace:
        """What a time step is solved in; after `start`."""
        return self._workspace

    def start(self, pressure_pa: ArrayLike, loads: Loads | None = None) -> Shape:
        """Begin at rest under gauge pressures (N,) [Pa]; raises as `statics` does."""
        pressure = pressures(self._arm, pressure_pa)
        resting = KernelArguments.of(self._arm, pressure[None])
        self.begin(resting, pressure, resting.tip(loads), *resting.load(self._arm, loads, self._nodes))
        self._loads = loads
        return shape(self._arm, self._problem, self._x, ok=True, stable=True)

    def begin(self, resting: KernelArguments, pressure: Array, tip: Array, load: Array, loaded: bool) -> None:
        """What `start` does, with all that hangs on the arm in the kernels' words; the arm at rest is prepared."""
        n = self._nodes
        self._last_s, self._step_s = self._dt_s, self._dt_s
        self._scheme, self._segments = self._even, _segments(n, self._even_growth)
        self._coefficients = _array(self._scheme)
        self._x, stable = states(resting, pressure, tip, load, loaded)
        if not stable:
            raise Unstable.at(pressure)
        self._problem = KernelArguments.of(self._arm, pressure[None], self._scheme.c0, self._dt_s)
        self._work = self._problem.work()
        branches = len(self._arm.material.branches)
        self._pool = aligned(workspace_size(n, branches))
        self._workspace = workspace_in(self._pool, n, branches)
        self._past_states = aligned(2, 2 * n + 2, STATE)
        initialise_history(self._coefficients, self._x, self._past_states, resting.length_m, self._workspace)
        self._hysteresis = Hysteresis(self._arm.actuation.stops, pressure)
        self._branch_strains = np.zeros((branches, 2 * n + 2, 6))
        self._branch_factors = branch_factors(self._arm.material, self._scheme.c0, self._dt_s)
        self._recall_branches()
        self._before = np.stack([pressure] * 3)
        self._loads, self._tip, self._load, self._loaded = None, tip, load, loaded
        self._prepare()
        self._started = True

    def step(self, pressure_pa: ArrayLike, loads: Loads | None = None, dt_s: float | None = None) -> Shape:
        """Advance by one time step under gauge pressures (N,) [Pa], held at the step's end.

        dt_s: length of this step [s]; default: that of the constructor. Steps may vary, with the order of the scheme;
        ValueError for one shorter than `shortest_step_s`, and for a scheme of fixed steps.
        Where the step cannot be solved, the shape is the last good one with ok=False, and the next step goes on from
        it. Raises ValueError for pressures or loads that are not finite or of the wrong shape.
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
        return shape(self._arm, self._problem, self._x, ok=bool(moved.ok[0]))

    def run(self, pressure_pa: ArrayLike) -> ArmTrajectory:
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
        if self._last_s != self._dt_s:
            raise ValueError("run continues steps of the constructor's length only: the last one had another")
        self._change_step(self._dt_s)
        # The kernel checks what it gets, at less cost; these compute with the rows before it.
        if (self._arm.by_pressure or self._arm.actuation.stops) and not np.isfinite(rows).all():
            raise ValueError(NOT_FINITE)
        return self._advance(self._hysteresis.advance(rows))

    def _change_step(self, dt_s: float) -> None:
        """Prepare a step of another length: its equations, and the history y^h (eq 26) by its coefficients.

        The rate y_t of the last step is part of the history with a weight d1 that no length of a step changes.
        """
        scheme = self._rule.varying_coefficients(dt_s, self._last_s, self._alpha)
        if scheme == self._scheme:
            return
        if dt_s < self.shortest_step_s:
            raise ValueError(f"a time step of {dt_s} s is shorter than {self.shortest_step_s:.3g} s")
        self._segments = _segments(self._nodes, self._even_growth * scheme.c0 / self._even.c0)
        before = self._scheme
        size, history = self._x.size, self._workspace.history
        for weight, past in (
            (scheme.c1 - before.c1, self._x),
            (scheme.c2 - before.c2, self._past_states[0]),
            (scheme.c3 - before.c3, self._past_states[1]),
        ):
            history[:size] += weight * past.ravel()
        _fill_between(history, size, self._problem.length_m / self._nodes)
        self._scheme, self._coefficients, self._step_s = scheme, _array(scheme), dt_s
        self._branch_factors = branch_factors(self._arm.material, scheme.c0, dt_s)
        self._recall_branches()
        self._problem = KernelArguments.of(self._arm, self._before[:1], scheme.c0, dt_s)
        self._work = self._problem.work()
        self._prepare()

    def _prepare(self) -> None:
        """Set the kernels' arguments, which most steps share."""
        self._arm_arguments = self._problem.arm(self._work, self._tip, self._load, self._loaded)
        self._state = MotionState(
            self._before, self._segments, self._coefficients, self._past_states, self._x, self._branch_factors,
            self._branch_strains,
        )  # fmt: skip

    def _recall_branches(self) -> None:
        """The past strains of the walls in the next step, where they are not the history itself."""
        if len(self._branch_strains):
            past = self._workspace.walls_past
            recall_branches(self._branch_factors, self._branch_strains, self._x, self._workspace.history, past)
            _fill_between(past, self._x.size, self._problem.length_m / self._nodes)

    def _advance(self, rows: Array) -> ArmTrajectory:
        if self._arm.by_pressure and len(rows):
            self._problem = KernelArguments.of(self._arm, rows, self._scheme.c0, self._step_s)
            self._work = self._problem.work()
            self._prepare()
        count = len(rows)
        tips = TipPoses(np.empty((count, 3)), np.empty((count, 3, 3)), np.empty(count, dtype=np.bool_))
        passes = motion(
            self._problem.walls, self._arm_arguments, self._state, rows, self._pool, TOLERANCE_IN_MOTION, tips
        )
        if passes < 0:
            raise ValueError(NOT_FINITE)
        return ArmTrajectory(*tips)

    def _set_loads(self, loads: Loads | None) -> None:
        self._tip = self._problem.tip(loads)
        self._load, self._loaded = self._problem.load(self._arm, loads, self._nodes)
        self._loads = loads
        self._prepare()

    def _growth(self) -> float:
        """Exponent by which the stiffest mode grows along the arm within one time step's equations, c0 L / c_shear."""
        if not self._arm.inertia:
            return 0.0
        material, geometry = self._arm.material, self._arm.geometry
        stiffness = self._arm.law.softest * float(self._arm.stiffness_n(np.zeros(geometry.actuators)).min())
        slowest = math.sqrt(material.shear_ratio * stiffness / (material.density_kg_m3 * geometry.wall_area_m2))
        return self._scheme.c0 * geometry.length_m / slowest


def _array(scheme: Coefficients) -> Array:
    return np.array([scheme.c0, scheme.c1, scheme.c2, scheme.c3, scheme.d1])


def _fill_between(history: Array, size: int, h: float) -> None:
    """The history half-way between the nodes and its slopes, by cubic Hermite; as `between` of the kernels."""
    nodes, slopes = (history[at : at + size // 2].reshape(-1, STATE) for at in (0, size // 2))
    middle = 0.5 * (nodes[:-1] + nodes[1:]) + 0.125 * h * (slopes[:-1] - slopes[1:])
    slope = 1.5 / h * (nodes[1:] - nodes[:-1]) - 0.25 * (slopes[:-1] + slopes[1:])
    for at, values in ((size, middle), (3 * size // 2, slope)):
        history[at : at + values.size] = values.ravel()


def _segments(nodes: int, growth: float) -> int:
    """The smallest divisor of `nodes` that keeps the growth within one segment harmless."""
    if growth < 2.5:
        return 1
    wanted = min(nodes, max(1, math.ceil(growth / 2)))
    return next(d for d in range(wanted, nodes + 1) if nodes % d == 0)
