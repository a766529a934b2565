"""Whether error bars hold for arms that are not the model: shares of 95 % intervals of parameters and predictions.

Run: python -m benchmarks.model_error [--trials 20] [--seed 0] [--workers 2] [--truth NAME ..] [--runs KIND]
                                      [--offset-pa 30] [--store DIR]

Each arm is drawn from the standard uncertainties, does what the truth of its row says, and is identified from plateaus.
Twenty poses with three pressed chambers are predicted. Three trials show the trend in about a minute.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import model
from calibration.identify.data import SETTLE_S
from calibration.identify.fit import identify
from calibration.identify.held_out_prediction import predict
from calibration.identify.nuisance import stated_values
from calibration.identify.parameter import Prior
from calibration.identify.parameters import named
from calibration.identify.poses import Poses
from calibration.identify.pressure_history import pressure_history
from calibration.identify.setup import Setup
from calibration.identify.simulated_experiments import MeasurementErrors, drawn_setup, perform, plan
from calibration.parallel_map import parallel_map
from model.arrays import Array
from rig.arm_effects.base import ArmEffectSection
from rig.arm_effects.effects import (
    CouplingSection,
    CreepBranch,
    CreepSection,
    GainsSection,
    HysteresisSection,
    PushSection,
    SlipElement,
    SofteningSection,
)

FREE = ("law", "rpe_per_bar", "cap_mass_kg", "shear_ratio", "base", "sensor_offsets")
_DWELL_S, _STEP_S = 4.0, 0.02
_RATE_BAR_S = 1.0
_HELD_OUT = 20
_PA = 1e5


def _backlash(slip_bar: float) -> HysteresisSection:
    return HysteresisSection(type="hysteresis", elements=(SlipElement(weight=1.0, slip_bar=slip_bar),))


def _creep(amount: float) -> CreepSection:
    branches = tuple(CreepBranch(amount=amount / 2, time_s=time_s) for time_s in (1.0, 10.0))
    return CreepSection(type="creep", branches=branches)


TRUTHS: dict[str, tuple[ArmEffectSection, ...]] = {
    "as modelled": (),
    "creep 4 %": (_creep(0.04),),
    "backlash 0.01 bar": (_backlash(0.01),),
    "push P (1 + 0.15 P)": (PushSection(type="push", per_bar=0.15),),
    "coupling 5 %": (CouplingSection(type="coupling", share=0.05),),
    "gains 1, 1.03, 0.97": (GainsSection(type="gains", gains=(1.0, 1.03, 0.97)),),
    "push with the sum": (PushSection(type="push", per_bar=0.08, pressure="sum"),),
    "softening": (SofteningSection(type="softening", by_peak=0.05, peak_bar=0.3, by_cycles=0.03, travel_bar=2.0),),
    "weaker actuator": (GainsSection(type="gains", gains=(0.95, 1.0, 1.0)), _backlash(0.004)),
    "all at once": (
        GainsSection(type="gains", gains=(0.96, 0.975, 0.945)),
        CouplingSection(type="coupling", share=0.01),
        PushSection(type="push", per_bar=0.05),
        SofteningSection(type="softening", by_peak=0.02, peak_bar=0.3, by_cycles=0.01, travel_bar=2.0),
        _backlash(0.003),
        _creep(0.03),
    ),
}


@dataclass(frozen=True)
class _Trial:
    truth: str
    runs: str
    offset_pa: float
    seed: int


def _levels() -> dict[str, Callable[[np.random.Generator], list[tuple[str, Array, Array | None]]]]:
    """Plateaus of the runs to identify from, by kind: name, pressures (K, 3) [bar] and weights (K,) [kg]."""
    ramp = np.linspace(0.15, 0.65, 11)[:, None]
    both = np.concatenate([ramp, ramp[-2::-1]])
    first, others = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 1.0])
    weights = ("weights", np.zeros((13, 3)), np.linspace(0.0, 1.2, 13))
    return {
        "ramps": lambda rng: [("ramp-a", ramp * first, None), ("ramp-b", ramp * others, None)],
        "weights": lambda rng: [weights, ("ramp-a", ramp * first, None), ("ramp-b", ramp * others, None)],
        "cycles": lambda rng: [weights, ("cycle-a", both * first, None), ("cycle-b", both * others, None)],
        "mixed": lambda rng: [weights, ("mixed", rng.uniform(0.05, 0.65, (22, 3)), None)],
    }


def _staircase(levels_bar: Array) -> tuple[Array, Array]:
    """Times (n,) [s] and pressures (n, N) [bar] that go through levels (K, N), from zero."""
    rows, now = [np.zeros((1, levels_bar.shape[1]))], np.zeros(levels_bar.shape[1])
    for level in levels_bar:
        rise = max(1, int(np.ceil(np.abs(level - now).max() / (_RATE_BAR_S * _STEP_S))))
        rows.append(now + (level - now) * np.arange(1, rise + 1)[:, None] / rise)
        rows.append(np.tile(level, (round(_DWELL_S / _STEP_S) - rise, 1)))
        now = level
    course = np.concatenate(rows)
    return np.arange(len(course)) * _STEP_S, course


def _done(
    name: str, levels_bar: Array, weight_kg: Array | None, trial: _Trial, arm: Setup, rng: np.random.Generator
) -> Poses:
    """The run of an arm that does what the trial's truth says."""
    errors = MeasurementErrors((3e-5, 3e-5, 6e-5), 20.0, trial.offset_pa)
    planned = plan(name, levels_bar * _PA, weight_kg, errors=errors)
    time_s, course = _staircase(levels_bar)
    felt = course
    for section in TRUTHS[trial.truth]:
        effect = section.effect(course.shape[1], _STEP_S)
        felt = np.array([effect.advance(row) for row in felt.tolist()])
    stop = np.arange(1, len(levels_bar) + 1) * round(_DWELL_S / _STEP_S) + 1
    start = stop - round((_DWELL_S - SETTLE_S) / _STEP_S)
    means = np.array([felt[a:b].mean(axis=0) for a, b in zip(start, stop, strict=True)])
    middle_s = time_s[(start + stop) // 2]
    planned = replace(planned, time_s=time_s[stop - 1], history=pressure_history(time_s, course * _PA, middle_s))
    return perform(planned, arm, rng, errors, felt_pa=means * _PA)


def run_trial(trial: _Trial) -> Array:
    """Whether the interval of each free parameter holds (1 or 0), NaN where it has none, and figures of the prediction.

    Of the prediction: shares that hold along x, y, z and in 3-D, rms error [mm], rms of the stated deviation [mm],
    discrepancy [mm], and whether the fit says that the model is wrong.
    """
    rng = np.random.default_rng(trial.seed)
    start = Setup(model.Arm.paper())
    stated = stated_values(start, {})
    arm = drawn_setup(start, stated, rng)
    data = [_done(name, levels, kg, trial, arm, rng) for name, levels, kg in _levels()[trial.runs](rng)]
    new = _done("new", rng.uniform(0.05, 0.6, (_HELD_OUT, 3)), None, trial, arm, rng)
    priors = {f"sensor_{n + 1}_offset_pa": Prior(0.0, trial.offset_pa) for n in range(3)}
    fit = identify(data, start, FREE, priors, starts=1, stated=stated)
    held = []
    for parameter in named(FREE[:-1], 3):
        low, high = fit[parameter.name].interval or (np.nan, np.nan)
        true = parameter.read(arm)
        held.append(float(low <= true <= high) if np.isfinite(low) else np.nan)
    found = predict(fit, new)
    said = float(fit.discrepancy_m > 0)
    return np.array([*held, *found.share_in_95, 1e3 * found.rms_m, 1e3 * found.std_m, 1e3 * fit.discrepancy_m, said])


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--trials", type=int, default=20)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--workers", type=int, default=2)
    options.add_argument("--truth", nargs="+", choices=[*TRUTHS], default=[*TRUTHS])
    options.add_argument("--runs", choices=[*_levels()], default="weights")
    options.add_argument("--offset-pa", type=float, default=30.0, help="standard deviation of the sensors' zeros")
    options.add_argument("--store", type=Path, help="keep finished trials there, to resume")
    options.add_argument("--parameters", action="store_true", help="show each parameter, too")
    given = options.parse_args()
    began = time.perf_counter()
    names = [p.name for p in named(FREE[:-1], 3)]
    print(f"{'truth':20s} | parameters: hold, given | predictions: axes, 3-D | rms, stated [mm] | off by [mm], said")
    for truth in given.truth:
        tasks = [_Trial(truth, given.runs, given.offset_pa, given.seed * 1_000_003 + k) for k in range(given.trials)]
        rows = np.array(parallel_map(run_trial, tasks, given.workers, store=given.store))
        held, rest = rows[:, : len(names)], rows[:, len(names) :]
        known = np.isfinite(held)
        axes, ellipsoid = 100 * rest[:, :3].mean(), 100 * rest[:, 3].mean()
        rms, stated = np.sqrt((rest[:, 4:6] ** 2).mean(axis=0))
        print(
            f"{truth:20s} | {100 * held[known].mean():11.1f} %, {known.sum(axis=1).mean():5.1f} "
            f"| {axes:11.1f} %, {ellipsoid:5.1f} % "
            f"| {rms:6.3f}, {stated:6.3f}   | {np.median(rest[:, 6]):6.4f}, {100 * rest[:, 7].mean():4.0f} %",
            flush=True,
        )
        if given.parameters:
            for name, column in zip(names, held.T, strict=True):
                own = column[np.isfinite(column)]
                print(f"    {name:16s} {100 * own.mean() if len(own) else np.nan:5.1f} % of {len(own)}")
    print(f"{given.trials} trials of each in {time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()
