"""An unknown payload, hung on the tip during a run: how soon the tip is back, and how well its mass is known.

    python -m benchmarks.tip_payload [--runs 20] [--payload 50] [--seed 1] [--effects]

Arms as in `benchmarks.tip_control`, drawn at random; half of the runs hold a point 20 to 45 mm from the axis, half
follow a circle of 20 mm radius in 2 to 6 s. The payload is hung 6 s after the start. Printed for each run: the time
after which the true tip stays within 0.3 mm of the reference, the error 1 s later as RMS, the estimated change of mass
after 2 s, and its stated standard deviation; then how many of the stated 95 % intervals contain the mass. With
`--effects` the arms also have what the simulator's `mock` has beyond the model, as in `benchmarks.tip_control`. A run
without a change is one in which the estimator states none after 2 s.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np

import model
from benchmarks.tip_closed_loop import CYCLE_S, ClosedLoop, Task, Truth, simulate
from benchmarks.tip_control import LIMIT_PA, RATE_PA_S, drawn, effects_of, published
from model.arrays import Array
from model.inverse.static_map import StaticMap
from rig.tip_control.horizon import HorizonControl
from rig.tip_control.interface import TipControlSettings
from rig.tip_control.tip_dynamics import TipDynamics
from runs.interpolation import interpolated

HUNG_S, END_S = 6.0, 9.0
NEAR_M = 0.3e-3


class Poses:
    """Held points and circles, with the feed-forward of the first-mode model."""

    def __init__(self, arm: model.Arm) -> None:
        self._map, self._dynamics = StaticMap.of(arm, (0, 1, 2), LIMIT_PA), TipDynamics.of(arm, LIMIT_PA)

    def task(self, rng: np.random.Generator, *, held: bool) -> tuple[str, Task]:
        """A pose at random, with its name."""
        times = np.arange(0.0, END_S + 2.0, CYCLE_S)
        if held:
            radius, angle, height = rng.uniform(0.02, 0.045), rng.uniform(0, 2 * np.pi), rng.uniform(0.18, 0.195)
            turns, period = np.full_like(times, angle), None
            name = f"held {1e3 * radius:.0f} mm"
        else:
            radius, period, height = 0.02, rng.uniform(2.0, 6.0), 0.19
            turns = 2 * np.pi / period * np.where(times < 1, 0.5 * times**2, times - 0.5)
            name = f"circle {period:.1f} s"
        position = np.stack([radius * np.cos(turns), radius * np.sin(turns), np.full_like(turns, height)], axis=1)
        velocity = np.gradient(position, CYCLE_S, axis=0)
        drive = position + self._dynamics.tau_s * velocity
        drive += np.gradient(velocity, CYCLE_S, axis=0) / self._dynamics.omega_rad_s**2
        feed = self._map.inverse(drive, np.full(3, 3e4))

        def at(values: Array) -> Callable[[Array], Array]:
            return lambda times_s: interpolated(times_s, times, values)

        return name, Task(END_S, at(position), at(velocity), at(feed), period)


def back_s(run: ClosedLoop) -> float:
    """Time after the payload from which the tip stays within NEAR_M."""
    off = np.linalg.norm(run.tip_m - run.reference_m, axis=1)
    late = np.flatnonzero((off > NEAR_M) & (run.times_s >= HUNG_S))
    return float(run.times_s[late[-1]] - HUNG_S) if len(late) else 0.0


def weighed_kg(run: ClosedLoop) -> tuple[float, float]:
    """Change of the estimated payload from before the hanging to 2 s after it, and its stated standard deviation."""
    before = [plan for plan in run.plans if plan.times_s[0] < HUNG_S][-1].estimate
    after = next(plan for plan in run.plans if plan.times_s[0] >= HUNG_S + 2.0).estimate
    return after.payload_kg - before.payload_kg, after.change_std_kg


def main() -> None:
    """Print a row for each run, then the summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--payload", type=float, default=50.0, help="g")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--effects", action="store_true", help="the arm has what the model does not assume")
    args = parser.parse_args()
    arm = published()
    settings = TipControlSettings(arm, (0, 1, 2), LIMIT_PA, RATE_PA_S, 1 / 30, 0.04, 0.015)
    controller, poses, rng = HorizonControl(settings), Poses(arm), np.random.default_rng(args.seed)
    backs, masses, stated = [], [], []
    print(f"{args.runs} runs, seed {args.seed}, {args.payload:g} g")
    print("pose            back within 0.3 mm [s]   rms after 1 s [mm]   mass [g]")
    for k in range(args.runs):
        arm_truth = drawn(rng)
        name, task = poses.task(rng, held=k % 2 == 0)
        truth = Truth(arm_truth.arm, arm_truth.strength, payload_kg=1e-3 * args.payload, payload_at_s=HUNG_S)
        effects = effects_of(np.random.default_rng([args.seed, k])) if args.effects else []
        run = simulate(settings, controller, truth, task, args.seed + k, effects)
        mass, std = weighed_kg(run)
        backs.append(back_s(run))
        masses.append(1e3 * mass - args.payload)
        stated.append(1e3 * std)
        after = 1e3 * run.rms_m(HUNG_S + 1.0)
        print(f"{name:15} {backs[-1]:10.2f} {after:24.3f} {1e3 * mass:15.1f} +- {1e3 * std:.1f}", flush=True)
    off, found = np.abs(masses), np.isfinite(stated)
    within = np.mean(off <= 3.0)
    print(f"back: median {np.median(backs):.2f} s, worst {max(backs):.2f} s")
    print(f"mass: median error {np.median(off):.1f} g, 95 % {np.percentile(off, 95):.1f} g; {within:.0%} within 3 g")
    covered, unknown = np.count_nonzero(off[found] <= 1.96 * np.array(stated)[found]), np.count_nonzero(~found)
    print(f"{covered} of {len(off) - unknown} stated 95 % intervals contain the mass; {unknown} runs without a change")


if __name__ == "__main__":
    main()
