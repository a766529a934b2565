"""What measured sections add to the tip in an identification: error bars and their coverage on drawn arms.

Every number of an arm, its mounting and its boards is drawn from its standard uncertainty; the same experiments are
then identified by the tip alone and with boards along the arm.

Run: nice python -m benchmarks.sections [--trials 40] [--seed 1] [--workers 1] [--moving | --sideways]
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass, replace

import numpy as np

import model
from calibration.identify.fit import identify
from calibration.identify.nuisance import stated_values
from calibration.identify.parameter import Prior
from calibration.identify.parameters import named
from calibration.identify.poses import Poses
from calibration.identify.section_mounts import mount_priors
from calibration.identify.setup import Setup
from calibration.identify.simulated_experiments import MeasurementErrors, drawn_setup, perform, plan
from calibration.parallel_map import parallel_map
from model.arrays import Array

FREE = ("law", "rpe_per_bar", "shear_ratio", "base", "tool")
NAMES = tuple(p.name for p in named(FREE, 3))
POSITIONS = MeasurementErrors((5e-5, 1e-4, 5e-5), 20.0, 300.0, section_m=(5e-5, 1e-4, 5e-5))
POSES = replace(POSITIONS, rotation_rad=math.radians(0.1))
# Boards whose place was measured to half a millimetre and half a degree.
PLACED_M, PLACED_RAD = 5e-4, math.radians(0.5)
_SHARES = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.6], [0.2, 0.0, 1.0])
SIDEWAYS_M_S2 = (9.81, 0.0, 0.0)
KINDS = {
    "tip": ((), POSITIONS),
    "tip and 2 sections": ((1 / 3, 2 / 3), POSITIONS),
    "tip with orientation": ((), POSES),
    "tip and 2 sections with orientation": ((1 / 3, 2 / 3), POSES),
}


@dataclass(frozen=True)
class Trial:
    """One drawn arm, identified with sections at these shares of its length."""

    shares: tuple[float, ...]
    errors: MeasurementErrors
    moving: bool
    sideways: bool
    seed: int


def planned_runs(task: Trial, length_m: float) -> list[Poses]:
    """Three ramps of plateaus, two under a weight; or a motion under a weight."""
    at_m = {f"b{k}": share * length_m for k, share in enumerate(task.shares)}
    if task.moving:
        time_s = np.arange(90) / 30
        sine = 1e5 * (0.05 + np.array([0.25, 0.1, 0.0]) * (1 - np.cos(2.0 * time_s[:, None])))
        return [plan("sine", sine, np.full(90, 0.1), 1 / 30, task.errors, at_m)]
    ramp = np.linspace(0.1e5, 0.6e5, 9)[:, None]
    heavy_kg = 0.05 if task.sideways else 0.2
    loads = (0.0, heavy_kg, heavy_kg)
    shares = dict(zip(("ramp-a", "ramp-b", "ramp-c"), zip(_SHARES, loads, strict=True), strict=True))
    return [
        plan(name, ramp * np.array(share), np.full(9, weight_kg), errors=task.errors, sections_m=at_m)
        for name, (share, weight_kg) in shares.items()
    ]


def trial(task: Trial) -> Array:
    """Error and standard deviation of each parameter, (2, n); NaN where it was not identified."""
    arm = model.Arm.paper()
    start = Setup(replace(arm, rod_weight=True).with_segment(material=replace(arm.material, damping_s=0.02)))
    if task.sideways:
        start = replace(start, arm=replace(start.arm, gravity_m_s2=SIDEWAYS_M_S2))
    planned = planned_runs(task, arm.length_m)
    stated = stated_values(start, {"damping_s": 0.005, "sensor_filter_s": 1e-9, "sensor_offsets": 300.0})
    stated |= {name: Prior(0.0, PLACED_M if name.endswith("_m") else PLACED_RAD) for name in mount_priors(planned)}
    # The same arm and the same experiments, whatever is measured of them.
    truth = drawn_setup(start, stated, np.random.default_rng([task.seed, 0]))
    boards = drawn_setup(start, stated, np.random.default_rng([task.seed, 1]), planned).sections
    truth = replace(truth, sections=boards)
    data = [perform(one, truth, np.random.default_rng([task.seed, 2, k]), task.errors) for k, one in enumerate(planned)]
    offsets = {name: stated[name] for name in (f"sensor_{n + 1}_offset_pa" for n in range(3))}
    fit = identify(data, start, (*FREE, "sensor_offsets"), offsets, stated=stated)
    out = np.full((2, len(NAMES)), np.nan)
    for k, parameter in enumerate(named(FREE, 3)):
        found = fit[parameter.name]
        if found.value is not None and found.std is not None:
            out[:, k] = found.value - parameter.read(truth), found.std
    return out


def print_coverage(title: str, found: Array, alone: Array) -> None:
    """Print coverage and median error bars of trials (n, 2, parameters), and these over those by the tip alone."""
    z = found[:, 0] / found[:, 1]
    known = np.isfinite(z)
    print(f"{title}: 95 % intervals hold {100 * (np.abs(z[known]) <= 1.96).mean():.1f} % of {known.sum()}")
    for k, name in enumerate(NAMES):
        std, before = found[:, 1, k], alone[:, 1, k]
        both = np.isfinite(std) & np.isfinite(before)
        ratio = f"{np.median(std[both] / before[both]):.2f}" if both.any() else "-"
        bar = f"{np.nanmedian(std):.3g}" if np.isfinite(std).any() else "-"
        held = int((np.abs(z[known[:, k], k]) <= 1.96).sum())
        print(
            f"  {name:14s} identified {int(known[:, k].sum()):3d} of {len(z)}, holds {held:3d}, median bar {bar:>9s}, "
            f"over the tip's {ratio}"
        )


def main() -> None:
    """Print the tables."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--trials", type=int, default=40)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--workers", type=int, default=1)
    options.add_argument("--moving", action="store_true", help="a motion in place of three ramps of plateaus")
    options.add_argument("--sideways", action="store_true", help="an arm that lies: weights shear and bend it")
    given = options.parse_args()
    alone: Array | None = None
    seed = given.seed * 1_000_003
    for title, (shares, errors) in KINDS.items():
        tasks = [Trial(shares, errors, given.moving, given.sideways, seed + k) for k in range(given.trials)]
        began = time.process_time()
        found = np.array(parallel_map(trial, tasks, given.workers))
        alone = found if alone is None else alone
        print_coverage(title, found, alone)
        print(f"  {time.process_time() - began:.0f} s of CPU in this process", flush=True)


if __name__ == "__main__":
    main()
