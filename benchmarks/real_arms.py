"""Real arms as the judge: rod and baselines on fixed splits of public data, for docs/validation/identification.md.

    python -m benchmarks.real_arms [--only braided bellows "two sections"]

The data are kept beside the checkout, in ../shared/data; mappings and arms are in docs/examples. Every method sees the
fit's part of a split alone: lag, regularisation and hyperparameters are chosen by blocks left out inside it, and the
left-out part is predicted once. `rod` is `rig identify --quasi-static` without other options. The arm of two sections
has no rod: its bore is not stated, and a chamber acts on its own section; the baselines alone are compared.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from calibration.baselines.comparison import Comparison, MethodErrors
from calibration.baselines.methods import BASELINES, BaselineMethod, PredictTips
from calibration.baselines.repeatability import repeatability
from calibration.baselines.selection import fit_baselines
from calibration.baselines.tip_inputs import TipInputs
from calibration.identify import Poses, quasi_static_poses, split_at
from model.arrays import Array
from rig.identify.from_archives import IdentificationData, OpenedRuns, from_data
from rig.identify.initial_setup import initial_rig
from rig.importing.archive_builder import import_table
from runs.run import Run

ROOT = Path(__file__).resolve().parents[1]
DATA, EXAMPLES = ROOT.parent / "shared" / "data", ROOT / "docs" / "examples"
# Frames of a run that a fit sees: every n-th.
MOST_FRAMES = 200
GP_ENTRIES = 150

Part = tuple[str, str, float]
"""A run, and the part of it: before or after a time [s] since its first frame, or all of it."""


@dataclass(frozen=True)
class Arm:
    """Runs of an arm: file, mapping; and whether `rig identify` can describe it."""

    runs: Mapping[str, tuple[str, str]]
    rod: bool = True


@dataclass(frozen=True)
class Split:
    """What is fitted and what is predicted."""

    arm: str
    name: str
    fit: tuple[Part, ...]
    predict: tuple[Part, ...]


ARMS = {
    "braided": Arm(
        {
            "NoLoad": ("stiff_flop/NoLoad.mat", "stiff-flop.yaml"),
            "Load1": ("stiff_flop/Load1.mat", "stiff-flop-loaded.yaml"),
        }
    ),
    "bellows": Arm({name: (f"bellows_arm/{name}.csv", "bellows.yaml") for name in ("step5psi", "step15psi")}),
    "two sections": Arm(
        {
            name: (f"two_section_arm/{name}.txt", "two-section.yaml")
            for name in (*(f"jan19_{k}" for k in range(3, 9)), *(f"apr4_{k}" for k in range(1, 5)))
        },
        rod=False,
    ),
}


def _all(name: str) -> Part:
    return name, "all of", 0.0


SPLITS = (
    Split("braided", "before 36 s -> rest, higher", (("NoLoad", "before", 36.0),), (("NoLoad", "after", 36.0),)),
    Split("braided", "unloaded -> loaded", (_all("NoLoad"),), (_all("Load1"),)),
    Split(
        "braided",
        "unloaded, loaded before 31 s -> rest",
        (_all("NoLoad"), ("Load1", "before", 31.0)),
        (("Load1", "after", 31.0),),
    ),
    Split(
        "braided",
        "unloaded, loaded after 31 s -> before",
        (_all("NoLoad"), ("Load1", "after", 31.0)),
        (("Load1", "before", 31.0),),
    ),
    Split(
        "bellows",
        "three steps of 15 psi -> three more",
        (("step15psi", "before", 56.0),),
        (("step15psi", "after", 56.0),),
    ),
    Split("bellows", "5 psi -> 15 psi", (_all("step5psi"),), (_all("step15psi"),)),
    Split("bellows", "15 psi -> 5 psi", (_all("step15psi"),), (_all("step5psi"),)),
    *(
        Split("two sections", f"jan19_{k} -> again", (_all(f"jan19_{k}"),), (_all(f"jan19_{k + 1}"),))
        for k in (3, 5, 7)
    ),
    Split(
        "two sections", "three combinations -> a fourth", tuple(_all(f"apr4_{k}") for k in (1, 2, 3)), (_all("apr4_4"),)
    ),
)


class GaussianProcess:
    """A Gaussian process of each coordinate over lagged pressures and forces: squared exponential with a length scale
    for each input, amplitude and noise by the marginal likelihood (Rasmussen & Williams 2006, eq 5.8)."""

    name = "Gaussian process"
    weights = (1.0,)

    def fit(self, data: TipInputs, weight: float, quick: bool = False) -> PredictTips:
        """The posterior mean; hyperparameters are of all coordinates together."""
        data = data.only(np.linspace(0, len(data) - 1, min(len(data), 60 if quick else GP_ENTRIES)).astype(int))
        inputs = np.concatenate([data.pressure_bar, data.force_n], axis=1)
        scale = np.maximum(inputs.std(axis=0), 1e-3)
        at, mean = inputs / scale, data.tip_m.mean(axis=0)
        spread = np.maximum(data.tip_m.std(axis=0), 1e-6)
        values = (data.tip_m - mean) / spread

        def kernel(one: Array, other: Array, log: Array) -> Array:
            a, b = one / np.exp(log[:-2]), other / np.exp(log[:-2])
            squares = (a**2).sum(1)[:, None] + (b**2).sum(1) - 2 * a @ b.T
            out: Array = np.exp(2 * log[-2] - 0.5 * np.maximum(squares, 0))
            return out

        apart = (at[:, None, :] - at[None, :, :]) ** 2

        def cost(log: Array) -> tuple[float, Array]:
            """Minus the log marginal likelihood and its gradient."""
            smooth, noise = kernel(at, at, log), np.exp(2 * log[-1])
            try:
                factor = cho_factor(smooth + noise * np.eye(len(at)), lower=True)
            except np.linalg.LinAlgError:
                return 1e10, np.zeros_like(log)
            solved = cho_solve(factor, values)
            value = 0.5 * float((values * solved).sum()) + 3 * float(np.log(np.diagonal(factor[0])).sum())
            weight = 3 * cho_solve(factor, np.eye(len(at))) - solved @ solved.T
            by_scale = 0.5 * np.einsum("ij,ij,ijd->d", weight, smooth, apart) / np.exp(2 * log[:-2])
            return value, np.concatenate([by_scale, [(weight * smooth).sum(), noise * np.trace(weight)]])

        first = np.concatenate([np.full(at.shape[1], 0.7), [0.0, -2.0]])
        bounds = [(-2.0, 5.0)] * at.shape[1] + [(-3.0, 4.0), (-7.0, 1.0)]
        log = minimize(cost, first, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 100}).x
        factor = cho_factor(kernel(at, at, log) + np.exp(2 * log[-1]) * np.eye(len(at)), lower=True)
        solved = cho_solve(factor, values)

        def predict(other: TipInputs) -> Array:
            new = np.concatenate([other.pressure_bar, other.force_n], axis=1) / scale
            out: Array = kernel(new, at, log) @ solved * spread + mean
            return out

        return predict


METHODS: tuple[BaselineMethod, ...] = (*BASELINES, GaussianProcess())


def judged(split: Split, runs: Callable[[str], Run]) -> tuple[list[Comparison], float | None, float]:
    """The comparisons of a split, the repeatability [m] of its data, and the processor time of the rod [s]."""
    cache: dict[str, Poses] = {}

    def part(one: Part) -> Poses:
        name, which, at_s = one
        whole = cache.setdefault(name, quasi_static_poses(runs(name)))
        if which == "all of":
            return whole
        before, after = split_at(whole, float(whole.time_s[0]) + at_s)
        return before if which == "before" else after

    parts = [part(one) for one in split.fit]
    seen = [one.only(np.arange(0, len(one), -(-len(one) // MOST_FRAMES))) for one in parts]
    unseen = [part(one) for one in split.predict]
    floor, begun = repeatability([*cache.values()]), time.process_time()
    found: list[Comparison] = []
    if ARMS[split.arm].rod:
        first = runs(split.fit[0][0])
        data = IdentificationData(OpenedRuns((first,), (), ()), initial_rig(first, None), seen, unseen, True)
        done = from_data(data, free=(), priors={})
        rods = [MethodErrors.of("rod", p.measured_m - p.predicted_m, p.covariance_m2) for p in done.predictions]
        length_m = done.fit.start.arm.length_m
    else:
        rods, length_m = [], float(np.median(seen[0].tip_m[:, 2]))
    spent_s = time.process_time() - begun
    fits = fit_baselines(seen, (0.0, 0.0, 9.81), METHODS)
    for k, poses in enumerate(unseen):
        errors = [poses.tip_m[poses.has_tip] - one.predict(poses) for one in fits]
        rows = [MethodErrors.of(one.name, e, one.covariance_m2) for one, e in zip(fits, errors, strict=True)]
        found.append(Comparison(split.name, len(errors[0]), False, length_m, (*rods[k : k + 1], *rows)))
    return found, None if floor is None else floor.rms_m, spent_s


def main() -> None:
    """Import, fit, predict, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=sorted(ARMS), default=sorted(ARMS))
    asked = parser.parse_args()
    if not DATA.is_dir():
        parser.exit(2, f"the data are missing: this benchmark reads {DATA}, which is kept beside the checkout\n")
    print("| arm | split | method | rms [mm] | largest [mm] | of length | in 95 % |\n|---|---|---|---|---|---|---|")
    ratios: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        for name in asked.only:
            runs = _imported(ARMS[name], Path(folder))
            for split in (one for one in SPLITS if one.arm == name):
                found, floor, spent_s = judged(split, runs)
                for compared in found:
                    _print(name, compared, floor)
                    if ARMS[name].rod:
                        print(f"| | processor time of the rod | | {spent_s:.1f} s | | | |", flush=True)
                        ratios.append(compared.ratio)
    if ratios:
        mean = float(np.exp(np.mean(np.log(ratios))))
        print(f"\nrod over best baseline: {min(ratios):.2f} to {max(ratios):.2f}, geometric mean {mean:.2f}")


def _imported(arm: Arm, folder: Path) -> Callable[[str], Run]:
    """Import each run when it is first asked for."""
    found: dict[str, Run] = {}

    def run(name: str) -> Run:
        if name not in found:
            file, mapping = arm.runs[name]
            with contextlib.redirect_stderr(io.StringIO()):
                found[name] = Run(import_table(DATA / file, EXAMPLES / mapping, folder).archive)
        return found[name]

    return run


def _print(arm: str, compared: Comparison, floor_m: float | None) -> None:
    for row in compared.methods:
        share = "" if np.isnan(row.share_in_95) else f"{100 * row.share_in_95:.0f} %"
        length = f"{100 * row.rms_m / compared.length_m:.1f} %"
        print(
            f"| {arm} | {compared.data} | {row.method} | {1e3 * row.rms_m:.2f} | {1e3 * row.largest_m:.1f} "
            f"| {length} | {share} |"
        )
    if floor_m is not None:
        print(f"| {arm} | {compared.data} | *repeatability* | {1e3 * floor_m:.2f} | | | |")


if __name__ == "__main__":
    main()
