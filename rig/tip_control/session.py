"""Tip control during a run: from rows of the record to the controller's step, and to the row that is recorded."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from model.units import PA_PER_BAR
from protocols.tip_reference import TipMotion
from rig.config.arm_model import model_arm
from rig.config.schema import RigConfig
from rig.config.sections import Variant
from rig.config.tip_controllers import CONTROLLERS
from rig.control.plan_follower import StampedPlan
from rig.execution.plan import RunPlan
from rig.tip_control.interface import ControllerMeasurement, ReferenceTrajectory, SetPointPlan, TipControlSettings
from runs.columns import PLAN_AHEAD_S
from runs.interpolation import interpolated
from runs.records import DetectionStatus, SolveStatus, blank, tip_control_dtype

HISTORY_S = 1.0
"""Time before a frame of whose control cycles a controller sees the set-points and pressures."""


def settings(config: RigConfig, variant: Variant | None, *, learned: bool = False) -> TipControlSettings:
    """What a controller knows of a rig."""
    return TipControlSettings(
        arm=model_arm(config, variant),
        valve_of=config.valve_of,
        pressure_limit_pa=config.limits.pressure_bar * PA_PER_BAR,
        rate_limit_pa_s=config.limits.rate_bar_per_s * PA_PER_BAR,
        frame_s=1 / config.observation_hz,
        delay_s=config.tip_control.delay_ms * 1e-3,
        pressure_lag_s=config.tip_control.pressure_lag_ms * 1e-3,
        learned=learned,
    )


class TipControlSession:
    """The controller of one run. It reads no clock."""

    def __init__(self, plan: RunPlan) -> None:
        """Raises PluginError if the controller of the plan cannot be used."""
        self._trajectory = plan.trajectory
        self._actuators = plan.config.first_actuators
        self._settings = settings(plan.config, plan.variant, learned=bool(plan.learned_from))
        self._controller = CONTROLLERS[plan.tip_controller](self._settings)
        self._state: Any = self._controller.start()
        self._row = blank((), tip_control_dtype(len(plan.config.valves)))

    def step(
        self, observation: NDArray[np.void] | np.void, frame_protocol_s: float, samples: NDArray[np.void]
    ) -> tuple[StampedPlan, NDArray[np.void]] | None:
        """The plan that follows from a frame, and its row; None where the tip has no reference now.

        `frame_protocol_s` is the protocol time of the exposure; `samples` (k,) are the newest control cycles.

        Raises:
            Exception: the controller, which may be code of the user, fails.
        """
        start_s = float(samples["protocol_s"][-1])
        motion = self._trajectory.tip.motion_at(start_s)
        if motion is None or frame_protocol_s < 0:
            return None
        seen = observation["seen"] == DetectionStatus.MEASURED
        # The controller steers the arm without its learned difference from the model.
        learned = motion.learned_differences_m(np.clip([frame_protocol_s, start_s], motion.start_s, motion.stop_s))
        measurement = ControllerMeasurement(
            frame_protocol_s,
            np.array(observation["measured_m"]) - learned[0] if seen else np.full(3, np.nan),
            np.array(observation["covariance_m2"]),
            samples["protocol_s"],
            samples["setpoint_pa"][:, self._actuators],
            samples["measured_pa"][:, self._actuators],
            start_s,
        )
        plan = _checked(self._controller.step(self._state, self._reference(motion, start_s), measurement))
        self._state = plan.state
        row = self._row.copy()
        row["t_ns"], row["frame"], row["start_s"] = observation["t_ns"], observation["frame"], start_s
        row["status"], row["iterations"], row["active"] = plan.status, plan.iterations, plan.active
        stamped = StampedPlan.checked(plan.times_s, plan.setpoint_pa, len(self._actuators))
        if len(stamped.times_s):
            ahead = start_s + np.array(PLAN_AHEAD_S)
            within = ahead <= stamped.times_s[-1]
            row["plan_pa"][within] = interpolated(ahead[within], *stamped)
        if plan.predicted_m is not None and np.shape(plan.predicted_m)[1:] == (3,) and len(plan.predicted_m):
            row["predicted_m"] = plan.predicted_m[0] + learned[1]
        row["nis"] = plan.nis
        return stamped, row

    def warm_up(self) -> None:
        """Step twice on made-up data, so that imports and compilation are done before the start."""
        motion, valves = self._trajectory.tip.motions[0], len(self._actuators)
        state, frame_s = self._controller.start(), self._settings.frame_s
        # The second step begins with a state and a plan, which the first one has not.
        for start_s in (motion.start_s, motion.start_s + frame_s):
            measurement = ControllerMeasurement(
                start_s - frame_s,
                motion.position_m[0],
                1e-8 * np.eye(3),
                start_s + np.array([-frame_s, 0.0]),
                np.zeros((2, valves)),
                np.zeros((2, valves)),
                start_s,
            )
            state = _checked(self._controller.step(state, self._reference(motion, start_s), measurement)).state

    def _reference(self, motion: TipMotion, start_s: float) -> ReferenceTrajectory:
        times = self._settings.reference_times(start_s)
        within = np.minimum(times, motion.stop_s)
        over = (times > motion.stop_s)[:, None]
        position = motion.positions_m(within) - motion.learned_differences_m(within)
        velocity = motion.velocities_m_s(within) - motion.learned_rates_m_s(within)
        position, velocity = np.where(over, np.nan, position), np.where(over, np.nan, velocity)
        feed = self._trajectory.sample(times.tolist())[:, self._actuators]
        return ReferenceTrajectory(times, position, velocity, feed, motion.period_s)


def _checked(plan: SetPointPlan) -> SetPointPlan:
    """A plan of a controller, which may be code of the user. Raises ValueError: its status is not that of a solver."""
    if plan.status not in (SolveStatus.SOLVED, SolveStatus.NOT_SOLVED):
        raise ValueError(f"status of a plan is SOLVED or NOT_SOLVED; found {plan.status}")
    return plan
