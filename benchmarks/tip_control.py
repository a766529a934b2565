"""Tracking error of the tip in closed loop, over arms drawn at random, for each controller.

    python -m benchmarks.tip_control [--arms 20] [--controllers horizon] [--frequencies 1] [--repetitions 2] [--effects]

Pure simulation: the truth is the dynamic rod model with other parameters, a pressure lag of 15 ms, a camera at 30 Hz
with 0.1 mm noise per coordinate, and 40 ms from frame to plan. Printed is the RMS of the 3-D distance between
reference and true tip from the third period on, lag included: median and worst over the arms; and the processor time
of a step of the controller: set OPENBLAS_NUM_THREADS=1, as `rig` does. With `--effects` the arm has what the
simulator's `mock` has beyond the model (unequal strengths, coupling, softening, hysteresis, creep), each amount at
random between half and one and a half times that of the rig file. It keeps its state over the repetitions, with 30 s
of rest between two runs.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

import model
from benchmarks.support.tip_closed_loop import CYCLE_S, ClosedLoop, Task, Truth, simulate
from model.arrays import Array
from model.inverse.static_map import StaticMap
from rig.arm_effects.base import ArmEffect
from rig.config.loader import load
from rig.config.tip_controllers import CONTROLLERS, FEED_FORWARD
from rig.tip_control.interface import TipControlSettings
from rig.tip_control.learning import DisturbanceLearner, PathPeriod, Repetition
from rig.tip_control.tip_dynamics import TipDynamics
from runs.interpolation import interpolated

LIMIT_PA, RATE_PA_S = 0.7e5, 1e5
HEIGHT_M = 0.19
LEAD_IN_S = 2.0
PERIODS = 5
GRID_S = 0.005
REST_S = 30.0
END_S = 0.6
"""Last part of a run that is not counted: what is learned there lacks the path that follows."""


def circle(phase: Array) -> Array:
    """Points (T, 3) [m] of the circle of 20 mm radius."""
    return np.stack([0.02 * np.cos(phase), 0.02 * np.sin(phase), np.full_like(phase, HEIGHT_M)], axis=1)


def eight(phase: Array) -> Array:
    """Points (T, 3) [m] of the figure eight, 30 mm wide and 15 mm high."""
    return np.stack([0.015 * np.sin(phase), 0.0075 * np.sin(2 * phase), np.full_like(phase, HEIGHT_M)], axis=1)


PATHS = {"circle": circle, "eight": eight}


def published() -> model.Arm:
    """The arm that the controllers know: the paper's parameters, with the damping that mock-3 states."""
    arm = model.Arm.paper()
    return arm.with_segment(material=replace(arm.material, damping_s=0.01))


def drawn(rng: np.random.Generator) -> Truth:
    """A true arm: material 4 %, strengths 3 %, cap 2 g, damping between half and twice the stated one."""
    arm = published()
    material = arm.material
    factor = {
        name: getattr(material, name) * (1 + 0.04 * rng.standard_normal())
        for name in ("a1_per_n", "a2_per_n2", "rpe_per_bar", "shear_ratio", "density_kg_m3")
    }
    damping = material.damping_s * 2 ** rng.uniform(-1, 1)
    true = replace(arm, cap_mass_kg=0.05 + 0.002 * rng.standard_normal()).with_segment(
        material=replace(material, **factor, damping_s=damping)
    )
    return Truth(true, 1 + 0.03 * rng.standard_normal(3))


def effects_of(rng: np.random.Generator) -> list[ArmEffect]:
    """A new arm's effects, with amounts drawn at random."""
    simulator = load("mock").simulator
    assert simulator is not None
    effects = []
    for section in simulator.arm_effects:
        scaled = _scaled(section.model_dump(), lambda: rng.uniform(0.5, 1.5))
        effects.append(type(section).model_validate(scaled).effect(3, CYCLE_S))
    return effects


AMOUNTS = ("share", "per_bar", "by_peak", "by_cycles", "weight", "amount")


def _scaled(value: Any, factor: Callable[[], float], name: str = "") -> Any:
    """A section with each amount times a factor; gains are scaled in their distance from 1."""
    if isinstance(value, dict):
        return {key: _scaled(item, factor, key) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_scaled(item, factor, name) for item in value]
    if name == "gains":
        return 1 + (value - 1) * factor()
    return value * factor() if name in AMOUNTS else value


def rest(effects: Sequence[ArmEffect]) -> None:
    """Let the arm rest without pressure."""
    for _ in range(round(REST_S / CYCLE_S)):
        bar = [0.0, 0.0, 0.0]
        for effect in effects:
            bar = effect.advance(bar)


class Feedforward:
    """Set-points of a path by the inverse of the first-mode model, on a grid."""

    def __init__(self, arm: model.Arm) -> None:
        self._map, self._dynamics = StaticMap.of(arm, (0, 1, 2), LIMIT_PA), TipDynamics.of(arm, LIMIT_PA)

    def task(self, path: str, frequency_hz: float) -> Task:
        """The path with a lead-in that starts at rest on it."""
        duration = LEAD_IN_S + PERIODS / frequency_hz
        times = np.arange(0.0, duration + 2.0, GRID_S)
        turns = np.where(times < LEAD_IN_S, 0.5 * times**2 / LEAD_IN_S, times - 0.5 * LEAD_IN_S)
        position = PATHS[path](2 * np.pi * frequency_hz * turns)
        velocity = np.gradient(position, GRID_S, axis=0)
        drive = position + self._dynamics.tau_s * velocity
        drive += np.gradient(velocity, GRID_S, axis=0) / self._dynamics.omega_rad_s**2
        feed = self._map.inverse(drive, np.full(3, 3e4))

        def at(values: Array) -> Callable[[Array], Array]:
            return lambda times_s: interpolated(times_s, times, values)

        return Task(duration, at(position), at(velocity), at(feed), 1 / frequency_hz)


def repeated(learner: DisturbanceLearner, task: Task, run: ClosedLoop) -> Task:
    """The task with what one more run has shown."""
    given = task.learned_m(run.frame_s)
    once = Repetition(run.times_s, run.setpoint_pa, run.frame_s, run.measured_m, given)
    learned = learner.disturbance([once], run.times_s, PathPeriod(task.period_s or np.inf, 0.0, 0.0))
    feed = task.feedforward_pa(run.times_s)
    before = np.tile(feed[0], (round(1 / CYCLE_S), 1))
    corrected = learner.setpoints(feed, before, run.reference_m - learned, CYCLE_S)

    end_s, period_s = float(run.times_s[-1]), task.period_s or 0.0

    def at(values: Array) -> Callable[[Array], Array]:
        """Beyond the end of the run, which the controller sees, the last period is continued."""

        def found(times_s: Array) -> Array:
            late = end_s - period_s + (times_s - end_s) % (period_s or np.inf)
            return interpolated(np.where(times_s > end_s, late, times_s), run.times_s, values)

        return found

    return replace(task, feedforward_pa=at(corrected), learned_m=at(learned))


def main() -> None:
    """Print one row for each path, frequency and controller."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arms", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--paths", nargs="+", default=list(PATHS))
    parser.add_argument("--frequencies", nargs="+", type=float, default=[0.1, 0.5, 1.0])
    parser.add_argument("--controllers", nargs="+", default=[FEED_FORWARD, *reversed(CONTROLLERS.built_in)])
    parser.add_argument("--repetitions", type=int, default=0, help="runs from which the last one learns")
    parser.add_argument("--effects", action="store_true", help="the arm has what the model does not assume")
    args = parser.parse_args()
    arm = published()
    settings = TipControlSettings(arm, (0, 1, 2), LIMIT_PA, RATE_PA_S, 1 / 30, 0.04, 0.015)
    knowing, learner = replace(settings, learned=True), DisturbanceLearner(settings)
    feedforward = Feedforward(arm)
    controllers = {name: None if name == FEED_FORWARD else CONTROLLERS[name](settings) for name in args.controllers}
    print(f"{args.arms} arms, seed {args.seed}; RMS 3-D distance to the true tip from the third period [mm]")
    print("path    Hz    controller          median    worst    solve p50 / p99 [ms]")
    for path in args.paths:
        for frequency in args.frequencies:
            task = feedforward.task(path, frequency)
            for name, controller in controllers.items():
                rng, errors, solves = np.random.default_rng(args.seed), [], []
                for k in range(args.arms):
                    truth, asked, current = drawn(rng), task, controller
                    effects = effects_of(np.random.default_rng([args.seed, k])) if args.effects else []
                    for repetition in range(args.repetitions + 1):
                        run = simulate(settings, current, truth, asked, args.seed + k + 1000 * repetition, effects)
                        rest(effects)
                        if repetition < args.repetitions:
                            asked = repeated(learner, asked, run)
                            current = None if name == FEED_FORWARD else CONTROLLERS[name](knowing)
                    errors.append(1e3 * run.rms_m(LEAD_IN_S + 2 / frequency, task.duration_s - END_S))
                    solves.append(run.solve_s)
                times = 1e3 * np.concatenate(solves)
                spent = f"{np.median(times):.2f} / {np.percentile(times, 99):.2f}" if len(times) else "-"
                print(
                    f"{path:7} {frequency:<5g} {name:18} {np.median(errors):7.3f}  {max(errors):7.3f}    {spent}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
