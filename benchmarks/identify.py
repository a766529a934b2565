"""How honest and how fast identification is: coverage of its error bars, and archives per minute by workers.

Run: python -m benchmarks.identify [--moving | --drawn | --default KIND [--as-modelled]] [--trials 200] [--seed 0]
                                   [--workers 1 2] [--store DIR]
     python -m benchmarks.identify --archives data/*.h5 --workers 1 2
     python -m benchmarks.identify --figure FILE
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import model
import runs
from calibration.identify.fitting.fit import identify
from calibration.identify.observations.poses import Poses
from calibration.identify.presentation import figures
from calibration.identify.simulated_experiments import (
    LAG_PRIOR,
    Coverage,
    CoverageTrial,
    MeasurementErrors,
    coverage,
    perform,
    plan,
    run_trial,
)
from calibration.identify.unknowns.nuisance import stated_values
from calibration.identify.unknowns.parameter import Prior
from calibration.identify.unknowns.parameters import named
from calibration.identify.unknowns.setup import Setup
from calibration.parallel_map import parallel_map
from model.arrays import Array
from rig.config.loader import load
from rig.identify.estimation import from_poses, read_poses
from rig.identify.initial_setup import rig_of
from rig.observation.online_estimation import default_parameters
from runs.report.drawing import save

FREE_MOVING = ("damping_s", "density_kg_m3", "sensor_lag_s", "rpe_per_bar")
FREE = ("law", "rpe_per_bar", "cap_mass_kg", "base_x_m", "base_z_m", "base_ry_rad")
FREE_DRAWN = (
    "law", "rpe_per_bar", "cap_mass_kg", "shear_ratio", "base", "tool", "actuator_angles", "damping_s",
    "density_kg_m3", "sensor_lag_s",
)  # fmt: skip


def experiment() -> tuple[tuple[Poses, ...], Setup, Setup]:
    """The paper's four static experiments, a true arm, and the published one as the start."""
    start = Setup(model.Arm.paper())
    material = replace(start.arm.material, a1_per_n=0.0079, a2_per_n2=0.00034, rpe_per_bar=0.049)
    arm = replace(start.arm, cap_mass_kg=0.056).with_segment(material=material)
    truth = Setup(arm, base_translation_m=(1e-3, 0.0, -5e-4), base_rotation_rad=(0.0, 0.01, 0.0))
    ramp = np.linspace(0.15e5, 0.65e5, 11)[:, None]
    weights = np.linspace(0.0, 1.2, 13)
    planned = (
        plan("ramp-a", ramp * np.array([1.0, 0.0, 0.0])),
        plan("ramp-b", ramp * np.array([0.0, 1.0, 1.0])),
        plan("extension-pressure", ramp * np.ones(3)),
        plan("extension-weights", np.zeros((13, 3)), weights),
    )
    return planned, truth, start


def motions(trials: int, seed: int) -> list[CoverageTrial]:
    """Eight seconds of two sines each, every time of another arm: its damping, density, RPE and the sensors' delay."""
    rng = np.random.default_rng([seed, 1])
    time_s, start = np.arange(240) / 30, Setup(model.Arm.paper())
    phase = 2 * np.pi * time_s[:, None] * np.array([0.6, 0.9, 0.9]) + np.array([0.0, 1.0, 1.0])
    planned = plan("two sines", 1e5 * (0.35 + 0.2 * np.sin(phase)), period_s=1 / 30)
    material = replace(start.arm.material, damping_s=0.02)
    start = replace(start, arm=start.arm.with_segment(material=material))
    tasks = []
    for k in range(trials):
        true = replace(
            material,
            damping_s=rng.uniform(0.005, 0.03),
            density_kg_m3=rng.uniform(900.0, 1300.0),
            rpe_per_bar=rng.uniform(0.048, 0.058),
        )
        truth = replace(start, arm=start.arm.with_segment(material=true), sensor_lag_s=rng.normal(0.0, LAG_PRIOR.std))
        tasks.append(CoverageTrial((planned,), truth, start, FREE_MOVING, MeasurementErrors(), seed * 1_000_003 + k))
    return tasks


def drawn(trials: int, seed: int) -> list[CoverageTrial]:
    """Weights, two ramps and eight seconds of a sine, each time of another arm: almost every parameter is drawn.

    Parameters that the data cannot separate are held at wrong values.
    """
    rng, errors = np.random.default_rng([seed, 2]), MeasurementErrors((3e-5, 3e-5, 6e-5), 10.0, 300.0)
    ramp, time_s = np.linspace(0.15e5, 0.65e5, 11)[:, None], np.arange(240) / 30
    sine = 0.35e5 + 0.25e5 * np.sin(np.pi * time_s)[:, None]
    planned = (
        plan("weights", np.zeros((13, 3)), np.linspace(0.0, 1.2, 13), errors=errors),
        plan("ramp-a", ramp * np.array([1.0, 0.0, 0.0]), errors=errors),
        plan("ramp-b", ramp * np.array([0.0, 1.0, 1.0]), errors=errors),
        plan("sine", sine * np.array([1.0, 0.0, 0.0]), period_s=1 / 30, errors=errors),
    )
    paper = model.Arm.paper()
    known = replace(paper, rod_weight=True).with_segment(material=replace(paper.material, damping_s=0.02))
    tasks = []
    for k in range(trials):
        material = replace(
            known.material,
            a1_per_n=float(np.exp(rng.uniform(np.log(0.005), np.log(0.012)))),
            a2_per_n2=float(np.exp(rng.uniform(np.log(1.2e-4), np.log(6e-4)))),
            rpe_per_bar=rng.uniform(0.01, 0.09),
            shear_ratio=float(np.exp(rng.uniform(np.log(0.25), np.log(0.8)))),
            density_kg_m3=rng.uniform(900.0, 1400.0),
            damping_s=float(np.exp(rng.uniform(np.log(0.003), np.log(0.05)))),
        )
        truth = Setup(
            replace(known, cap_mass_kg=rng.uniform(0.02, 0.15)).with_segment(material=material),
            base_translation_m=_each(rng, 0.01),
            base_rotation_rad=_each(rng, 0.07),
            tool_offset_m=_each(rng, 0.008),
            actuator_turn_rad=_each(rng, 0.17),
            sensor_lag_s=rng.normal(0.0, LAG_PRIOR.std),
        )
        tasks.append(CoverageTrial(planned, truth, Setup(known), FREE_DRAWN, errors, seed * 1_000_003 + k))
    return tasks


def by_default(kind: str, trials: int, seed: int) -> list[CoverageTrial]:
    """The default form of `rig identify`: each number of each arm is drawn from its standard uncertainty."""
    errors = MeasurementErrors((3e-5, 3e-5, 6e-5), 20.0, 500.0)
    ramp, time_s = np.linspace(0.15e5, 0.65e5, 11)[:, None], np.arange(240) / 30
    static = plan("ramp-a", ramp * np.array([1.0, 0.0, 0.0]), errors=errors)
    both = (
        static,
        plan("ramp-b", ramp * np.array([0.0, 1.0, 1.0]), errors=errors),
        plan("weights", np.zeros((13, 3)), np.linspace(0.0, 1.2, 13), errors=errors),
    )
    sine = 1e5 * (0.05 + np.array([0.3, 0.0, 0.0]) * (1 - np.cos(1.4 * time_s[:, None])))
    moving = plan("sine", sine, period_s=1 / 30, errors=errors)
    planned = {"static": (static,), "several": both, "moving": (moving,)}[kind]
    start = Setup(model.Arm.paper())
    # A damping that is drawn about zero would often be its bound.
    known_damping = replace(start.arm.material, damping_s=0.02)
    truth = replace(start, arm=start.arm.with_segment(material=known_damping))
    stated = stated_values(truth, {"damping_s": 0.005, "sensor_filter_s": 1e-9})
    # A trial frees the offsets of its sensors by itself.
    shared = [name for name in default_parameters(load("mock-ideal")) if name != "sensor_offsets"]
    free = (*shared, *(("damping_s",) if kind == "moving" else ()))
    return [CoverageTrial(planned, truth, truth, free, errors, seed * 1_000_003 + k, stated) for k in range(trials)]


def _each(rng: np.random.Generator, most: float) -> tuple[float, float, float]:
    x, y, z = rng.uniform(-most, most, 3).tolist()
    return x, y, z


def read_and_identified(files: tuple[Path, ...]) -> Array:
    """Archives to numbers: what is done with each group of them in the measurement of throughput."""
    archives = [runs.open(file) for file in files]
    free = ("law", "rpe_per_bar", "base", "sensor_offsets")
    return np.array([e.used for e in from_poses(rig_of(archives[0]), read_poses(archives), free, {}).estimates])


def draw(file: Path, seed: int) -> None:
    """Draw the intervals of one simulated identification, with the truth, as its report does."""
    planned, truth, start = experiment()
    rng = np.random.default_rng(seed)
    data = [perform(one, truth, rng) for one in planned]
    fit = identify(data, start, (*FREE, "sensor_offsets"), {"sensor_offsets": Prior(0.0, 200.0)})
    true = {one.name: one.read(truth) for one in named(FREE, 3)}
    save(figures.estimates, (9, 5.5), file, fit, true)


def print_coverage(found: Coverage) -> None:
    """Print how often the intervals held the truth."""
    for name, share, column in zip(found.names, found.share, found.z.T, strict=True):
        z = column[np.isfinite(column)]
        scatter = f"z {z.mean():+.2f} +- {z.std():.2f}" if len(z) else ""
        print(f"  {name:16s} covered {100 * share:5.1f} % of {len(z)} identified, {scatter}")
    print(f"  overall          covered {100 * found.overall:5.1f} %")


def throughput(files: list[Path], workers: int) -> None:
    """Print archives per minute, read and identified three at a time."""
    groups = [tuple(files[k : k + 3]) for k in range(0, len(files), 3)]
    began = time.perf_counter()
    parallel_map(read_and_identified, groups, workers)
    took = time.perf_counter() - began
    print(f"{workers} workers: {len(files)} archives in {took:.1f} s, {60 * len(files) / took:.0f} a minute")


def main() -> None:
    """Print the tables, or draw."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--trials", type=int, default=200)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--workers", type=int, nargs="+", default=[2])
    instead = options.add_mutually_exclusive_group()
    instead.add_argument("--moving", action="store_true", help="coverage of damping, density and delay in motion")
    instead.add_argument(
        "--default",
        choices=("static", "several", "moving"),
        help="coverage of the default form; every number is drawn",
    )
    instead.add_argument("--drawn", action="store_true", help="coverage of all parameters of arms drawn at random")
    options.add_argument("--store", type=Path, help="keep finished trials there, to resume")
    options.add_argument("--archives", type=Path, nargs="+", help="measure archives per minute with these instead")
    options.add_argument("--figure", type=Path, help="draw one identification there instead (png, pdf, svg)")
    given = options.parse_args()
    if given.figure is not None:
        draw(given.figure, given.seed)
        return
    planned, truth, start = experiment()
    for workers in given.workers:
        if given.archives:
            throughput(given.archives, workers)
            continue
        began = time.perf_counter()
        if given.moving or given.drawn or given.default:
            if given.default:
                tasks = by_default(given.default, given.trials, given.seed)
            else:
                tasks = (drawn if given.drawn else motions)(given.trials, given.seed)
            free = tasks[0].free
            z = np.array(parallel_map(run_trial, tasks, workers, store=given.store))
            found, count = Coverage(tuple(p.name for p in named(free, 3)), z), len(tasks[0].planned)
        else:
            found, count = (
                coverage(planned, truth, start, FREE, given.trials, None, given.seed, workers, store=given.store),
                len(planned),
            )
        took = time.perf_counter() - began
        rate = given.trials * count / took * 60
        print(f"{workers} workers: {given.trials} times {count} runs in {took:.0f} s, {rate:.0f} runs/min")
        print_coverage(found)


if __name__ == "__main__":
    main()
