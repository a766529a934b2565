"""Model predictive control: the set-points of the next frames from a quadratic program.

Single shooting: the tip over the horizon and its sensitivities are computed under the last plan, and one Gauss-Newton
step per frame corrects it. The unknowns are deviations from the feed-forward at a few times (blocked moves).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import daqp
import numpy as np

from model.arrays import Array
from model.inverse.static_map import StaticMap
from model.units import PA_PER_BAR
from rig.tip_control.estimation.estimator import TipEstimator, tip_map_of
from rig.tip_control.estimation.state import EstimatorState
from rig.tip_control.interface import (
    ControllerMeasurement,
    ReferenceTrajectory,
    SetPointPlan,
    SolveStatus,
    TipControlSettings,
)
from rig.tip_control.kernels.arguments import (
    FilteredState,
    QuadraticProgram,
    ReferenceSamples,
    TimedSetPoints,
)
from rig.tip_control.kernels.condensed_qp import gauss_newton_program, plan_of
from rig.tip_control.kernels.prediction import advanced
from rig.tip_control.move_blocking import HORIZON, MoveBlocking
from rig.tip_control.tip_dynamics import TipDynamics

STEPS_PER_FRAME = 2
RATE_WEIGHT = 0.04
"""Cost of a deviation's rate of 1 bar/s, as a tip error [mm] that costs the same."""
MOST_ITERATIONS = 200
_SOLVED = (1, 2)
"""Exit flags of DAQP: optimal, and optimal with soft constraints violated."""
_SOFT = 8


class HorizonState(NamedTuple):
    """The model's motion (3, 4) at the last frame, its time (NaN at the start), estimator and last plan."""

    motion: Array
    time_s: float
    estimator: EstimatorState
    times_s: Array
    setpoint_pa: Array


class HorizonControl:
    """EKF, periodic observer and a quadratic program over the horizon."""

    def __init__(self, settings: TipControlSettings) -> None:
        self._settings = settings
        self._map = StaticMap.of(settings.arm, settings.valve_of, settings.pressure_limit_pa)
        self._tip_map = tip_map_of(self._map)
        self._dynamics = TipDynamics.of(settings.arm, settings.pressure_limit_pa)
        self._estimator = TipEstimator(self._map, learned=settings.learned)
        self._step_s = settings.frame_s / STEPS_PER_FRAME
        self._blocking = MoveBlocking.of(self._map.valves, settings.frame_s, RATE_WEIGHT)
        self._times = self._step_s * np.arange(HORIZON * STEPS_PER_FRAME + 1, dtype=np.float64)
        self._soft = np.full(len(self._blocking.constraints), _SOFT, dtype=np.int32)

    def start(self) -> HorizonState:
        """Nothing is known."""
        return HorizonState(
            np.zeros((3, 4)), math.nan, self._estimator.start(), np.empty(0), np.empty((0, self._map.valves))
        )

    def step(self, state: Any, reference: ReferenceTrajectory, measurement: ControllerMeasurement) -> SetPointPlan:
        """Correct the estimates by the frame, predict past the delays, and solve for the plan."""
        # The kernels are compiled for arrays in C order only.
        samples = TimedSetPoints(
            np.ascontiguousarray(measurement.sample_s), np.ascontiguousarray(measurement.setpoint_pa)
        )
        wanted = ReferenceSamples(
            np.ascontiguousarray(reference.times_s),
            np.ascontiguousarray(reference.position_m),
            np.ascontiguousarray(reference.feedforward_pa),
            float(reference.period_s or 0.0),
        )
        state, nis = self._observed(state, reference.period_s, measurement, samples)
        program = self.program(state, wanted, samples, measurement.start_s)
        return self._solved(state, program, wanted, measurement.start_s, nis)

    def _observed(
        self, state: HorizonState, period_s: float | None, measurement: ControllerMeasurement, samples: TimedSetPoints
    ) -> tuple[HorizonState, float]:
        """The state at the time of the frame, and the NIS."""
        passed_s = measurement.time_s - state.time_s
        # After a long gap, as of a stalled process, the motion from before it has decayed.
        moved_s = min(passed_s, measurement.time_s - float(samples.times_s[0]))
        if moved_s > 0:
            steps = max(1, round(moved_s / self._step_s))
        else:
            passed_s, moved_s, steps = 0.0, 0.0, 0
        dynamics = self._estimated(state)
        motion, pressure = advanced(
            self._tip_map, dynamics.omega_rad_s, dynamics.tau_s, state.motion, measurement.time_s - moved_s,
            measurement.time_s, steps, self._settings.pressure_lag_s, samples,
        )  # fmt: skip
        estimator, nis = state.estimator, math.nan
        if np.isfinite(measurement.tip_m).all():
            prediction = self._estimator.predict(estimator, motion, pressure, measurement.time_s, period_s)
            estimator, nis = self._estimator.update(
                estimator, measurement.tip_m, measurement.covariance_m2, prediction, passed_s, period_s
            )
            # The motion is that of the new estimate, to first order.
            own = self._estimator.layout.retardation
            motion[:, :2] += (estimator.z[own] - state.estimator.z[own]) * motion[:, 2:]
        return state._replace(motion=motion, time_s=measurement.time_s, estimator=estimator), nis

    def _estimated(self, state: HorizonState) -> TipDynamics:
        """The modes with the estimated retardation time."""
        return self._dynamics.retarded(float(state.estimator.z[self._estimator.layout.retardation]))

    def program(
        self, state: HorizonState, reference: ReferenceSamples, samples: TimedSetPoints, start_s: float
    ) -> QuadraticProgram:
        """The program of one Gauss-Newton step about the last plan; the state is that at the newest frame."""
        settings = self._settings
        found: QuadraticProgram = gauss_newton_program(
            self._tip_map, self._estimated(state).step(self._step_s),
            FilteredState(state.motion, state.time_s, state.estimator.z), samples, reference,
            TimedSetPoints(state.times_s, state.setpoint_pa), self._blocking, start_s, self._step_s,
            settings.pressure_lag_s, settings.rate_limit_pa_s * settings.frame_s,
        )  # fmt: skip
        return found

    def _solved(
        self,
        state: HorizonState,
        program: QuadraticProgram,
        reference: ReferenceSamples,
        start_s: float,
        nis: float,
    ) -> SetPointPlan:
        """The plan of the program's solution; without one it continues the last plan."""
        found, _, flag, info = daqp.solve(
            program.hessian, program.gradient, self._blocking.constraints, program.highest, program.lowest, self._soft,
            iter_limit=MOST_ITERATIONS,
        )  # fmt: skip
        solution = np.asarray(found)
        solved = flag in _SOLVED and bool(np.isfinite(solution).all())
        if not solved:
            solution = program.deviation_pa[1:].reshape(-1) / PA_PER_BAR
        times_s = start_s + self._times
        setpoint, predicted = plan_of(
            times_s, self._map.limit_pa, solution, reference, start_s + self._blocking.knots_s, program.deviation_pa,
            program.prediction,
        )  # fmt: skip
        return SetPointPlan(
            times_s, setpoint, predicted, state._replace(times_s=times_s, setpoint_pa=setpoint),
            SolveStatus.SOLVED if solved else SolveStatus.NOT_SOLVED,
            int(info["iterations"]), int(np.count_nonzero(info["lam"])), nis,
        )  # fmt: skip
