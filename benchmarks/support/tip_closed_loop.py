"""A closed loop in pure simulation: controller, plan follower, pressure lag, arm and camera, without rig and pictures.

Bit for bit repeatable from its seed. The benchmark and the tests use it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

import model
from model.arrays import Array
from model.dynamics import Dynamics
from model.units import PA_PER_BAR
from rig.arm_effects.base import ArmEffect
from rig.control.limiter import Limiter
from rig.control.plan_follower import PlanFollower
from rig.control.setpoints import Moment, SetPoint
from rig.tip_control.interface import (
    ControllerMeasurement,
    ReferenceTrajectory,
    SetPointPlan,
    TipController,
    TipControlSettings,
)

CYCLE_S = 0.005
_HISTORY_S = 1.0


@dataclass(frozen=True, eq=False)
class Task:
    """A reference over `duration_s`: positions and velocities (T, 3) and the set-points (T, V) at times (T,).

    `learned_m`: the disturbance (T, 3) that earlier runs have shown; the controller steers the arm without it.
    """

    duration_s: float
    position_m: Callable[[Array], Array] = field(repr=False)
    velocity_m_s: Callable[[Array], Array] = field(repr=False)
    feedforward_pa: Callable[[Array], Array] = field(repr=False)
    period_s: float | None
    learned_m: Callable[[Array], Array] = field(default=lambda times_s: np.zeros((len(times_s), 3)), repr=False)


@dataclass(frozen=True, eq=False)
class Truth:
    """The simulated arm and what its rig does beside it.

    `strength` (N,): factor on each actuator's pressure. `lag_s`: time constant of the pressures. `noise_m`: standard
    deviation of a measured coordinate. `payload_kg`: on the tip from `payload_at_s` on.
    """

    arm: model.Arm
    strength: Array
    lag_s: float = 0.015
    noise_m: float = 1e-4
    payload_kg: float = 0.0
    payload_at_s: float = 0.0


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """A simulated run: at times (T,) the reference and the true tip (T, 3), set-points (T, V), and the plans.

    `measured_m` (m, 3): what the camera saw in its frames (m,) `frame_s`.
    """

    times_s: Array
    reference_m: Array
    tip_m: Array
    setpoint_pa: Array
    frame_s: Array
    measured_m: Array
    plans: tuple[SetPointPlan, ...] = field(repr=False)
    solve_s: Array = field(repr=False)

    def rms_m(self, from_s: float, to_s: float = np.inf) -> float:
        """RMS of the 3-D distance [m] between reference and true tip, lag included."""
        used = (self.times_s >= from_s) & (self.times_s < to_s)
        gap = np.nan_to_num(self.tip_m[used] - self.reference_m[used])
        return float(np.sqrt(np.mean(np.sum(gap**2, axis=1))))


def simulate(
    settings: TipControlSettings,
    controller: TipController | None,
    truth: Truth,
    task: Task,
    seed: int,
    effects: Sequence[ArmEffect] = (),
) -> ClosedLoop:
    """Run a controller (None: the feed-forward alone) on a simulated arm.

    `effects` are advanced with time, in steps of CYCLE_S: an arm of several runs keeps them.
    """
    valve_of, rng = list(settings.valve_of), np.random.default_rng(seed)
    follower = PlanFollower(tuple(range(settings.valves)), settings.pressure_limit_pa)
    limiter = Limiter(0.0, settings.pressure_limit_pa, settings.rate_limit_pa_s)
    dynamics = Dynamics(truth.arm, CYCLE_S)
    loads = model.Loads(tip_force_n=truth.payload_kg * np.array(truth.arm.gravity_m_s2))
    state = controller.start() if controller is not None else None
    share = -np.expm1(-CYCLE_S / truth.lag_s)
    cycles = round(task.duration_s / CYCLE_S)
    tips = np.empty((cycles, 3))
    setpoints, pressures = np.empty((cycles, settings.valves)), np.empty((cycles, settings.valves))
    times, plans, solve_s = CYCLE_S * np.arange(cycles, dtype=np.float64), [], []
    references, feed, rest = task.position_m(times), task.feedforward_pa(times), np.zeros(settings.valves)
    pressure = feed[0, valve_of]
    tip = dynamics.start(_effective(effects, pressure) * truth.strength).tip_m
    pending: list[tuple[float, Array]] = []
    frames: list[float] = []
    seen_m: list[Array] = []
    frame, kept = 0, round(_HISTORY_S / CYCLE_S)
    for k in range(cycles):
        now = float(times[k])
        moment, protocol = Moment(now, CYCLE_S, last_pa=limiter.last_pa), SetPoint(feed[k], rest)
        live = follower.at(moment, protocol)
        point = limiter.limit(live or protocol, moment, live=live is not None)
        if k:
            pressure = pressure + share * (setpoints[k - 1][valve_of] - pressure)
            hung = loads if truth.payload_kg and now >= truth.payload_at_s else None
            tip = dynamics.step(_effective(effects, pressure) * truth.strength, hung).tip_m
        setpoints[k], pressures[k] = point.pressure_pa, pressure[[valve_of.index(v) for v in range(settings.valves)]]
        tips[k] = tip
        while frame * settings.frame_s <= now:
            at, seen = frame * settings.frame_s, tip if k == 0 else _between(tips, times, k, frame * settings.frame_s)
            measured_m = seen + truth.noise_m * rng.standard_normal(3)
            pending.append((at, measured_m))
            frames.append(at)
            seen_m.append(measured_m)
            frame += 1
        if controller is not None and pending and pending[0][0] + settings.delay_s <= now:
            at, seen = pending.pop(0)
            rows = slice(max(0, k + 1 - kept), k + 1)
            measured = ControllerMeasurement(
                at,
                seen - task.learned_m(np.array([at]))[0],
                max(truth.noise_m, 1e-6) ** 2 * np.eye(3),
                times[rows],
                setpoints[rows],
                pressures[rows],
                now,
            )
            begun = time.thread_time()  # other processes of the machine do not count
            plan = controller.step(state, _window(task, settings.reference_times(now)), measured)
            solve_s.append(time.thread_time() - begun)
            state = plan.state
            plans.append(plan._replace(state=None))
            follower.take(now, plan.times_s, plan.setpoint_pa)
    return ClosedLoop(
        times, references, tips, setpoints, np.array(frames), np.array(seen_m), tuple(plans), np.array(solve_s)
    )


def _effective(effects: Sequence[ArmEffect], pressure_pa: Array) -> Array:
    """Pressures (N,) [Pa] that give an arm without effects the same push."""
    bar = (pressure_pa / PA_PER_BAR).tolist() if effects else []
    for effect in effects:
        bar = effect.advance(bar)
    return np.array(bar) * PA_PER_BAR if effects else pressure_pa


def _between(tips: Array, times: Array, k: int, at_s: float) -> Array:
    share = (at_s - times[k - 1]) / CYCLE_S
    seen: Array = tips[k - 1] + share * (tips[k] - tips[k - 1])
    return seen


def _window(task: Task, times: Array) -> ReferenceTrajectory:
    return ReferenceTrajectory(
        times,
        task.position_m(times) - task.learned_m(times),
        task.velocity_m_s(times),
        task.feedforward_pa(times),
        task.period_s,
    )
