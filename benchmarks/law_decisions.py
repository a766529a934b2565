"""How often `rig identify compare --between` decides for the true law, from a protocol of `rig design --compare`.

Run: python -m benchmarks.law_decisions [--laws LAW_A LAW_B ..] [--rig mock] [--duration-s 60] [--trials 50] [--seed 0]
                                        [--workers 2] [--store DIR]

Each law is true in half of the trials. Every number of each arm, those of its law included, is drawn from the rig's
standard uncertainties about the arm of the law that is closest to the rig's; tips and pressures have errors.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import beta

from calibration.identify.candidates import Candidate
from calibration.identify.model_comparison import MIN_DECISIVE, ComparisonFit, fit_all
from calibration.identify.parameter import Prior
from calibration.identify.poses import Poses
from calibration.identify.setup import Setup
from calibration.identify.simulated_experiments import MeasurementErrors, drawn_setup, perform_as_planned
from calibration.parallel_map import parallel_map
from model.arrays import Array
from rig.config.arm_model import model_arm
from rig.config.loader import load
from rig.design.law_comparison import design_comparison
from rig.identify.estimation import rig_uncertainties, sensor_priors
from rig.identify.model_comparison import laws_named

PAIRS = (
    ("homogeneous+rpe", "inhomogeneous+rpe"),
    ("pointwise", "secant"),
    ("own-pressure", "pressure-sum"),
    ("inhomogeneous+rpe", "own-pressure"),
    ("homogeneous", "homogeneous+rpe"),
)


@dataclass(frozen=True)
class DecisionTrial:
    """One run: the plan, the arm about which the true one is drawn, the laws to decide between, and the seed.

    drawn: value and standard uncertainty of each number of the true arm; stated: what the rig file states of it.
    """

    planned: Poses
    truth: Setup
    drawn: dict[str, Prior]
    laws: tuple[Candidate, ...]
    stated: dict[str, Prior]
    errors: MeasurementErrors
    seed: int


def run_trial(trial: DecisionTrial) -> Array:
    """BIC of each law (2,), as `rig identify compare --between` finds it."""
    rng = np.random.default_rng(trial.seed)
    data = perform_as_planned(trial.planned, drawn_setup(trial.truth, trial.drawn, rng), rng, trial.errors)
    stated, priors = tuple(trial.stated.items()), tuple(sensor_priors(trial.stated).items())
    return np.array([fit_all(ComparisonFit(law, (data,), priors, stated=stated))[1] for law in trial.laws])


def trials_of(rig: str, names: tuple[str, str], duration_s: float, count: int, seed: int) -> list[DecisionTrial]:
    """Trials with the first law true, then as many with the second one; print the expected shares."""
    config = load(rig)
    errors = replace(MeasurementErrors(), offset_pa=max(sensor.accuracy_bar for sensor in config.sensors) * 1e5 / 2)
    found = design_comparison(config, names, duration_s, seed, errors)
    print(f"{found.laws[0].name} | {found.laws[1].name}, {len(found.planned)} plateaus in {duration_s:g} s, expected:")
    print("  " + ", ".join(f"{100 * one.share:.1f} % if {one.truth} is true" for one in found.separations), flush=True)
    start = Setup(model_arm(config))
    laws, stated = laws_named(names, start, "--laws"), rig_uncertainties(config, start)
    return [
        DecisionTrial(
            found.planned, law.unknowns.start, rig_uncertainties(config, law.unknowns.start), laws, stated, errors,
            (seed * 2 + which) * 1_000_003 + k,
        )
        for which, law in enumerate(found.laws)
        for k in range(count)
    ]  # fmt: skip


def print_decisions(bic: Array, names: tuple[str, str]) -> tuple[int, int]:
    """Print the decisions by BIC (trials, 2) for each true law; return how many are right, and how many wrong."""
    half = len(bic) // 2
    right, wrong = 0, 0
    for which, name in enumerate(names):
        gain = bic[which * half : (which + 1) * half] @ (np.array([-1.0, 1.0]) * (1 if which == 0 else -1))
        hits, misses = int((gain >= MIN_DECISIVE).sum()), int((gain <= -MIN_DECISIVE).sum())
        right += hits
        wrong += misses
        low = float(beta.ppf(0.025, hits, half - hits + 1)) if hits else 0.0
        print(
            f"  {name} true: {hits} of {half} right (95 % interval from {100 * low:.0f} %), {misses} wrong; "
            f"BIC lower by {np.median(gain):.0f} (median), {gain.min():.1f} at least",
            flush=True,
        )
    return right, wrong


def main() -> None:
    """Print the shares of each pair, and of all together."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--laws", nargs=2, action="append", metavar=("LAW_A", "LAW_B"), help="may be repeated")
    options.add_argument("--rig", default="mock")
    options.add_argument("--duration-s", type=float, default=60.0)
    options.add_argument("--trials", type=int, default=50, help="of each law")
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--workers", type=int, default=2)
    options.add_argument("--store", type=Path, help="keep finished trials there, to resume")
    given = options.parse_args()
    began, right, wrong, count = time.perf_counter(), 0, 0, 0
    for first, second in given.laws or PAIRS:
        tasks = trials_of(given.rig, (first, second), given.duration_s, given.trials, given.seed)
        bic = np.array(parallel_map(run_trial, tasks, given.workers, store=given.store))
        hits, misses = print_decisions(bic, (first, second))
        right, wrong = right + hits, wrong + misses
        count += len(bic)
    took = f"{time.perf_counter() - began:.0f} s"
    print(f"{right} of {count} decisions are right, {100 * right / count:.1f} %, and {wrong} wrong; {took}")


if __name__ == "__main__":
    main()
