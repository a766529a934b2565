"""`python -m benchmarks.memory`: are relaxation and hysteresis of simulated arms found within the stated error bars?

Two courses of 48 s, ramps and levels up and down with small reversals, one with chamber 1 and one with chambers 2 and
3; every quarter of a second a pose. Truths: the model's own branch and stop element with drawn numbers (`model`), and
the effects creep and hysteresis of the simulated bench, which work on the pressures of an elastic arm (`bench`). A
bench that creeps by g with the retardation time T has a branch of the relative modulus g and the relaxation time
T / (1 + g).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import numpy as np

from calibration.identify import Setup, identify
from calibration.identify.poses import Poses
from calibration.identify.simulated_experiments import MeasurementErrors, perform, plan_slow
from model import Arm
from model.actuation import Proportional, StopElement
from model.arrays import Array
from model.material import MaxwellBranch
from rig.arm_effects.effects import CreepBranch, CreepSection, HysteresisSection, SlipElement

PERIOD_S, BAR = 0.25, 1e5
CORNERS_BAR = (0.0, 0.5, 0.46, 0.5, 0.3, 0.6, 0.56, 0.1, 0.4, 0.0)
STRETCH_S = 2.5  # of each way between two levels, and of each level
MEMORY = ("branch_1_modulus", "branch_1_time_s", "stop_1_weight", "stop_1_width_pa")
TRUTHS = {"model": "inhomogeneous+rpe", "bench": "homogeneous+rpe", "bench, eq 32": "inhomogeneous+rpe"}
"""What is simulated, and the variant of its walls."""


@dataclass(frozen=True)
class Memory:
    """Numbers of one branch and one stop element: modulus, time [s], weight, width [Pa]."""

    modulus: float
    time_s: float
    weight: float
    width_pa: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Memory:
        """Moderate numbers."""
        return cls(rng.uniform(0.02, 0.1), rng.uniform(1.0, 4.0), rng.uniform(0.03, 0.1), rng.uniform(1e3, 5e3))

    def of(self, arm: Arm) -> Arm:
        """The arm with this memory."""
        material = replace(arm.material, branches=(MaxwellBranch(self.modulus, self.time_s),))
        return replace(arm, actuation=Proportional(stops=(StopElement(self.weight, self.width_pa),))).with_segment(
            material=material
        )

    @property
    def values(self) -> tuple[float, ...]:
        """In the order of MEMORY."""
        return self.modulus, self.time_s, self.weight, self.width_pa


def planned() -> list[Poses]:
    """The two courses."""
    corners = np.repeat(CORNERS_BAR, 2)
    parts = round(STRETCH_S / PERIOD_S)
    at = np.arange((len(corners) - 1) * parts + 1) / parts
    levels = BAR * np.interp(at, np.arange(len(corners)), corners)[:, None]
    return [plan_slow("one", levels * [1.0, 0.0, 0.0], PERIOD_S), plan_slow("two", levels * [0.0, 0.8, 0.5], PERIOD_S)]


def felt_pa(poses: Poses, memory: Memory) -> Array:
    """Effective pressures of the simulated bench under those of the poses."""
    retardation_s = memory.time_s * (1 + memory.modulus)
    element = SlipElement(weight=memory.weight, slip_bar=memory.width_pa / BAR)
    branch = CreepBranch(amount=memory.modulus, time_s=retardation_s)
    friction = HysteresisSection(type="hysteresis", elements=(element,)).effect(poses.actuators, PERIOD_S)
    creep = CreepSection(type="creep", branches=(branch,)).effect(poses.actuators, PERIOD_S)
    rows = [creep(friction((row / BAR).tolist())) for row in poses.pressure_pa]
    # The branch is stated over the modulus at rest, the bench's creep over the sudden response.
    return BAR * np.array(rows) / (1 + memory.modulus)


def errors_of(truth: str, seed: int) -> tuple[Array, Array]:
    """Errors (4,) in standard deviations and relative errors (4,) of the memory found; NaN where it was not."""
    rng = np.random.default_rng(seed)
    arm, memory = Arm.paper(TRUTHS[truth]), Memory.drawn(rng)
    start = Setup(Memory(0.05, 2.0, 0.05, 2e3).of(arm))
    plant = Setup(memory.of(arm) if truth == "model" else arm)
    data = [
        perform(one, plant, rng, MeasurementErrors(offset_pa=0.0), None if truth == "model" else felt_pa(one, memory))
        for one in planned()
    ]
    fit = identify(data, start, (*arm.law.parameters, "rpe_per_bar", *MEMORY))
    z, relative = np.full(4, np.nan), np.full(4, np.nan)
    for k, (name, true) in enumerate(zip(MEMORY, memory.values, strict=True)):
        found = fit[name]
        if found.std is not None:
            z[k], relative[k] = (found.used - true) / found.std, found.used / true - 1
    return z, relative


def main() -> None:
    """Print how often the intervals hold."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    for truth in TRUTHS:
        found = [errors_of(truth, given.seed + k) for k in range(given.trials)]
        z, relative = (np.array(part) for part in zip(*found, strict=True))
        print(f"truth: {truth}, {given.trials} arms")
        for k, name in enumerate(MEMORY):
            known = np.isfinite(z[:, k])
            hold = (np.abs(z[known, k]) < 1.96).mean() if known.any() else np.nan
            spread = np.sqrt(np.mean(relative[known, k] ** 2)) if known.any() else np.nan
            print(
                f"  {name:<18} identified {known.sum():>3}, 95 % intervals that hold {hold:>6.1%}, "
                f"rms error {spread:.1%} of the value",
                flush=True,
            )


if __name__ == "__main__":
    main()
