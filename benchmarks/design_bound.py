"""Whether any protocol halves the error bar of a parameter: a lower bound over every choice of blocks of `rig design`.

Run: python -m benchmarks.design_bound [--rig mock] [--duration-s 60]

No choice of n blocks has more information than n times all blocks together (in the Loewner order), so the bar by that
information and the priors is below that of every protocol of the blocks. It is computed for the rig's arm and those
drawn from its uncertainties, without and with errors of the model before data. `10 000 times` that information,
without errors of the model, shows what the data leave to the priors however long the experiment is.
"""

from __future__ import annotations

import argparse
import itertools
from dataclasses import dataclass, replace

import numpy as np

import protocols
from calibration.design.information import Unknowns, block_information, error_bars, of_interest
from calibration.identify.information import covariance
from calibration.identify.poses import Poses
from calibration.identify.simulated_experiments import MeasurementErrors
from model.arrays import Array
from rig.config.loader import load
from rig.design.blocks import BLOCK_S, blocks
from rig.design.design import ENDS_S, LIBRARY, framed, free_parameters, unknowns_of
from rig.design.expected_poses import expected_poses

# Time steps per frame, as while blocks are compared; and the factor of the last column.
_SUBSTEPS, _MANY = 4, 1e4


@dataclass(frozen=True)
class Bounds:
    """Lowest standard errors (n,) of the parameters: without errors of the model, with them, and of 10 000 times the
    information without them."""

    without: Array
    with_model_error: Array
    ten_thousand_times: Array


def bounds(unknowns: Unknowns, motion: Poses, frames: list[slice], count: int) -> Bounds:
    """Of an arm, for any `count` of the blocks that are ranges of frames of a motion."""
    problem = unknowns.problem([motion], _SUBSTEPS)
    n, z = len(problem.unknowns), np.zeros(len(problem.unknowns))
    information, prior = block_information(problem, frames)
    every, rates = information.sum(axis=0), np.abs(problem.rates(z))

    def bars(repeats: float, size: int) -> Array:
        part = np.s_[:size, :size]
        found = np.diagonal(covariance(prior[part] + repeats * every[part]))[:n]
        chosen: Array = (rates * np.sqrt(found))[of_interest(problem, unknowns)]
        return chosen

    return Bounds(bars(count, n), bars(count, len(prior)), bars(_MANY, n))


def main() -> None:
    """Print the bounds over the bar of the library."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--rig", default="mock")
    options.add_argument("--duration-s", type=float, default=60.0)
    given = options.parse_args()
    config, errors = load(given.rig), MeasurementErrors()
    free, candidates = free_parameters(config), blocks(config)
    every = protocols.from_steps("every block", framed(config, candidates)).expand(config.actuators)
    motion = expected_poses("blocks", every, config, errors)
    first = [round((ENDS_S + k * BLOCK_S) / motion.period_s) for k in range(len(candidates) + 1)]
    frames = [slice(a, b) for a, b in itertools.pairwise(first)]
    count = int((given.duration_s - 2 * ENDS_S + 1e-9) // BLOCK_S)
    unknowns = unknowns_of(config, free, [motion])
    found = [
        bounds(replace(unknowns, start=arm, arms=()), motion, frames, count) for arm in (unknowns.start, *unknowns.arms)
    ]
    known = [expected_poses(name, protocols.load(name).expand(config.actuators), config, errors) for name in LIBRARY]
    library = error_bars(known, unknowns_of(config, free, known))
    print(f"lowest bar of any {count} of {len(candidates)} blocks over the library's: the rig's arm, and medians of "
          f"{len(found) - 1} drawn arms")  # fmt: skip
    print("parameter          library   without model error    with it           10 000 times")
    for k, (name, bar) in enumerate(zip(library.names, library.std.tolist(), strict=True)):
        cells = []
        for kind in ("without", "with_model_error", "ten_thousand_times"):
            own = [float(getattr(one, kind)[k]) / bar for one in found]
            cells.append(f"{own[0]:6.3f} {np.median(own[1:]):6.3f}")
        print(f"{name:14s} {bar:11.3g}   " + "     ".join(cells))


if __name__ == "__main__":
    main()
