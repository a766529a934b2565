"""Whether the error bars that `rig design` expects are those that fits of simulated arms state and realise.

Run: python -m benchmarks.design [--of motion|rest] [--rig mock] [--trials 20] [--seed 0] [--workers 2] [--store DIR]
[--errors-of RUN]

Each number of each arm is drawn from the rig's standard uncertainties. `motion` is the 60 s protocol of the design,
`rest` the plateaus of four library protocols. Errors of measurement are those that `rig design` assumes, or those of a
run. A fit has the free parameters, nuisance parameters and priors of
`rig identify`.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import protocols
from calibration.design.information import ErrorBars, Unknowns, error_bars
from calibration.identify.fit import identify
from calibration.identify.parameter import Prior
from calibration.identify.parameters import known, named
from calibration.identify.poses import Poses
from calibration.identify.setup import Setup
from calibration.identify.simulated_experiments import MeasurementErrors, drawn_setup, perform_as_planned
from calibration.parallel_map import parallel_map
from model.arrays import Array
from rig.config.loader import load
from rig.config.schema import RigConfig
from rig.design.design import design, free_parameters, unknowns_of
from rig.design.expected_poses import errors_of_run, expected_poses
from rig.identify.estimation import rig_uncertainties
from runs.run import Run

STATIC = ("ramp-a", "ramp-b", "extension-pressure", "extension-weights")
# Of the arms about the rig's value: an arm that is drawn from the stated 20 ms would often have no damping.
DAMPING_STD_S = 0.002


@dataclass(frozen=True)
class BarsTrial:
    """One arm: planned runs, initial setup, names of free and nuisance parameters and priors of its fit, and the seed
    of truth and errors.

    stated: value and uncertainty of every parameter.
    """

    planned: tuple[Poses, ...]
    start: Setup
    free: tuple[str, ...]
    nuisance: tuple[str, ...]
    priors: dict[str, Prior]
    stated: dict[str, Prior]
    errors: MeasurementErrors
    seed: int


def run_trial(trial: BarsTrial) -> Array:
    """Error, standard error, the latter without the model error, and that expected for this arm, of each parameter.

    (4, n); NaN where the fit states no number.
    """
    rng, start = np.random.default_rng(trial.seed), trial.start
    drawn = dict(trial.stated)
    drawn["damping_s"] = Prior(start.arm.material.damping_s, DAMPING_STD_S)
    drawn["sensor_filter_s"] = Prior(start.sensor_filter_s, 1e-9)
    truth = drawn_setup(start, drawn, rng)
    data = [perform_as_planned(one, truth, rng, trial.errors) for one in trial.planned]
    fit = identify(data, start, trial.free, trial.priors, stated=trial.stated)
    bare = dict(zip((one.name for one in fit.estimates), np.sqrt(np.diagonal(fit.fitted_covariance)), strict=False))
    by_name = known(data[0].actuators)
    beside = tuple(by_name[name] for name in trial.nuisance)
    expected = error_bars(trial.planned, Unknowns(truth, named(trial.free, data[0].actuators), beside, trial.priors))
    rows = []
    for name, own in zip(expected.names, expected.std.tolist(), strict=True):
        estimate = fit[name]
        if estimate.value is None or estimate.std is None:
            rows.append((np.nan, np.nan, np.nan, own))
        else:
            true = by_name[name].read(truth)
            rows.append((estimate.value - true, estimate.std, float(bare[name]), own))
    return np.array(rows).T


def planned_runs(kind: str, config: RigConfig, free: tuple[str, ...], errors: MeasurementErrors) -> list[Poses]:
    """The designed protocol, or four static ones of the library."""
    if kind == "motion":
        found = [("design", design(config, free, errors=errors).protocol)]
    else:
        found = [(name, protocols.load(name)) for name in STATIC]
    return [expected_poses(name, one.expand(config.actuators), config, errors) for name, one in found]


def print_error_bars(expected: ErrorBars, found: Array) -> None:
    """Print, by parameter, the median of stated bars over the expected one, and the rms of errors over it.

    arms: the medians over the arms of the design; own arm: over the bar that is expected for the drawn arm itself, as
    its median, and the lowest and highest tenth. Stated bars without the model error are over those without it.
    """
    error, std, bare, own = found.swapaxes(0, 1)
    alone = expected.alone.tolist()
    print("                            stated/expected of          without model   rms error/expected of")
    print("parameter        expected   arms   own arm              error           arms   own arm   identified")
    for k, (name, bar) in enumerate(zip(expected.names, expected.std.tolist(), strict=True)):
        given = np.isfinite(std[:, k])
        if not given.any():
            print(f"{name:14s} {bar:10.3g}   not identified in any arm")
            continue
        low, middle, high = np.quantile(std[given, k] / own[given, k], [0.1, 0.5, 0.9]).tolist()
        at_arms, by_data = np.median(std[given, k]) / bar, np.median(bare[given, k]) / alone[k]
        rms = [float(np.sqrt(np.mean((error[given, k] / to) ** 2))) for to in (bar, own[given, k])]
        print(
            f"{name:14s} {bar:10.3g}   {at_arms:4.2f}   {middle:4.2f} ({low:4.2f}-{high:4.2f})     {by_data:8.2f}     "
            f"  {rms[0]:8.2f}   {rms[1]:7.2f}   {given.sum():10d}"
        )
    for label, to in (("arms", expected.std), ("own arm", own)):
        z = error / to
        z = z[np.isfinite(z)]
        print(f"rms of all {len(z)} errors over the expected bars ({label}): {np.sqrt((z**2).mean()):.2f}")


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--of", choices=("motion", "rest"), default="motion")
    options.add_argument("--rig", default="mock")
    options.add_argument("--trials", type=int, default=20)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--workers", type=int, default=2)
    options.add_argument("--store", type=Path, help="keep finished trials there, to resume")
    options.add_argument("--errors-of", type=Path, help="archive with the errors of measurement")
    given = options.parse_args()
    config, began = load(given.rig), time.perf_counter()
    offset_pa = max(sensor.accuracy_bar for sensor in config.sensors) * 1e5 / 2
    measured = MeasurementErrors() if given.errors_of is None else errors_of_run(Run(given.errors_of))
    errors = replace(measured, offset_pa=offset_pa)
    free = free_parameters(config)
    if given.of == "rest":
        free = tuple(name for name in free if name not in ("damping_s", "shear_ratio"))
    planned = planned_runs(given.of, config, free, errors)
    unknowns = unknowns_of(config, free, planned)
    stated = rig_uncertainties(config, unknowns.start)
    start: Setup = replace(unknowns.start, sensor_filter_s=stated["sensor_filter_s"].mean)
    unknowns = replace(unknowns, start=start)
    beside = tuple(one.name for one in unknowns.nuisance)
    task = BarsTrial(tuple(planned), start, free, beside, dict(unknowns.priors), stated, errors, 0)
    tasks = [replace(task, seed=given.seed * 1_000_003 + k) for k in range(given.trials)]
    found = np.array(parallel_map(run_trial, tasks, given.workers, store=given.store))
    print_error_bars(error_bars(planned, unknowns), found)
    print(f"{given.trials} arms in {time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()
