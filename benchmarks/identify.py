"""How honest and how fast identification is: coverage of its error bars, and archives per minute by workers.

Run: python -m benchmarks.identify [--trials 200] [--seed 0] [--workers 2] [--figure FILE]
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import model
from calibration.identify import figures
from calibration.identify.data import Poses
from calibration.identify.fit import identify
from calibration.identify.parameters import Prior, Setup, named
from calibration.identify.simulated import coverage, perform, plan
from runs.figures import save

FREE = ("law", "rpe_per_bar", "cap_mass_kg", "base_x_m", "base_z_m", "base_ry_rad")


def experiment() -> tuple[tuple[Poses, ...], Setup, Setup]:
    """The paper's four static experiments, a true arm, and the published one as the start."""
    start = Setup(model.Arm.paper())
    material = replace(start.arm.material, a1_per_n=0.0079, a2_per_n2=0.00034, rpe_per_bar=0.049)
    arm = replace(start.arm, material=material, cap_mass_kg=0.056)
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


def draw(file: Path, seed: int) -> None:
    """Draw the intervals of one simulated identification, with the truth, as its report does."""
    planned, truth, start = experiment()
    rng = np.random.default_rng(seed)
    data = [perform(one, truth, rng) for one in planned]
    fit = identify(data, start, (*FREE, "sensor_offsets"), {"sensor_offsets": Prior(0.0, 200.0)})
    true = {one.name: one.read(truth) for one in named(FREE, 3)}
    save(figures.estimates, (9, 5.5), file, fit, (), true)


def main() -> None:
    """Print both tables, or draw."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--trials", type=int, default=200)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--workers", type=int, nargs="+", default=[2])
    options.add_argument("--figure", type=Path, help="draw one identification there instead (png, pdf, svg)")
    given = options.parse_args()
    if given.figure is not None:
        draw(given.figure, given.seed)
        return
    planned, truth, start = experiment()
    for workers in given.workers:
        began = time.perf_counter()
        found = coverage(planned, truth, start, FREE, given.trials, seed=given.seed, workers=workers)
        took = time.perf_counter() - began
        rate = given.trials * len(planned) / took * 60
        print(f"{workers} workers: {given.trials} times {len(planned)} runs in {took:.0f} s, {rate:.0f} runs/min")
        for name, share, column in zip(found.names, found.share, found.z.T, strict=True):
            z = column[np.isfinite(column)]
            spread = f"z {z.mean():+.2f} +- {z.std():.2f}" if len(z) else ""
            print(f"  {name:16s} covered {100 * share:5.1f} % of {len(z)} identified, {spread}")
        print(f"  overall          covered {100 * found.overall:5.1f} %")


if __name__ == "__main__":
    main()
