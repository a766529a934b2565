"""`python benchmarks/rod_versions.py FOLDER`: speed of the rod model here over that of another checkout in FOLDER.

One process of each version measures in turn, part by part, so that both meet the same load. The report gives the
median of the ratios of a part over all rounds, and their quartiles. Create the other checkout with
`git worktree add FOLDER COMMIT`; both versions use the packages of the present environment.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

DT_S = 1 / 30
BAR = 1e5
ROOT = Path(__file__).parents[1]
VARIANTS = ("homogeneous+rpe", "inhomogeneous+rpe")
# Calls of one measurement, about 0.1 s.
CALLS = {
    "one second at 1e-6 m": 600,
    "one second, 20 intervals": 200,
    "one equilibrium": 1000,
    "an equilibrium with its gradient": 600,
    "200 equilibria": 12,
    "one 1 kHz step": 1000,
}


def actions(variant: str) -> dict[str, Callable[[], object]]:
    """What is measured, by name; written for the functions that all versions have in common."""
    from model import Arm, batch
    from model.dynamics import Dynamics
    from model.sensitivities import tip_gradient
    from model.statics import statics

    arm = Arm.paper(variant)  # type: ignore[arg-type, unused-ignore]
    t = np.arange(31) / 30
    sine_pa = np.stack([0.35 + 0.25 * np.sin(2 * np.pi * t + 4 * np.pi / 3), 0 * t, 0 * t], axis=1) * BAR
    pressure_pa = np.array([0.65, 0.2, 0.0]) * BAR
    rows_pa = np.random.default_rng(1).uniform(0, 0.65 * BAR, (200, 3))
    stepped = Dynamics(arm, 0.001)
    stepped.start((0.0, 0.0, 0.0))
    cycle = [0]

    def second(nodes: int) -> Callable[[], object]:
        dynamics = Dynamics(arm, DT_S, nodes=nodes)
        dynamics.start(sine_pa[0])
        return lambda: dynamics.run(sine_pa[1:])

    def step() -> None:
        cycle[0] = (cycle[0] + 1) % 1000
        assert stepped.step((0.5 * BAR if cycle[0] >= 500 else 0.0, 0.0, 0.0)).ok

    parts = (
        second(4), second(20), lambda: statics(arm, pressure_pa), lambda: tip_gradient(arm, pressure_pa),
        lambda: batch.statics(arm, rows_pa, workers=1), step,
    )  # fmt: skip
    return dict(zip(CALLS, parts, strict=True))


def measure() -> None:
    """Read names of parts as JSON, one a line; answer with the median CPU time [s] of a call."""
    of_variant = {variant: actions(variant) for variant in VARIANTS}
    for action in [action for parts in of_variant.values() for action in parts.values()]:
        action()
    print("ready", flush=True)
    for request in sys.stdin:
        variant, part = json.loads(request)
        action, calls = of_variant[variant][part], CALLS[part]
        times_s = np.empty(calls)
        for k in range(calls):
            start = time.thread_time_ns()
            action()
            times_s[k] = (time.thread_time_ns() - start) / 1e9
        print(float(np.median(times_s)), flush=True)


class Version:
    """A process that measures the version in a folder."""

    def __init__(self, folder: Path) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-P", __file__, "--measure"],
            env={**os.environ, "PYTHONPATH": str(folder)},
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._read()

    def time_s(self, variant: str, part: str) -> float:
        """CPU time [s] of one call."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps([variant, part]) + "\n")
        self._process.stdin.flush()
        return float(self._read())

    def close(self) -> None:
        """End the process."""
        self._process.communicate()

    def _read(self) -> str:
        assert self._process.stdout is not None
        answer = self._process.stdout.readline()
        if not answer:
            raise SystemExit(f"the process of one version ended with status {self._process.wait()}")
        return answer


def compare(other: Path, rounds: int, parts: list[str]) -> None:
    """Print the ratios of the parts for both variants."""
    print(f"CPU time of the version in {ROOT.name} over that in {other.name}, {rounds} rounds: median (quartiles)")
    versions = [Version(ROOT), Version(other)]
    for part in parts:
        for variant in VARIANTS:
            times_s = np.empty((rounds, 2))
            for k in range(rounds):
                # Each is first in every other round.
                for which in (0, 1) if k % 2 else (1, 0):
                    times_s[k, which] = versions[which].time_s(variant, part)
            low, middle, high = np.quantile(times_s[:, 0] / times_s[:, 1], [0.25, 0.5, 0.75])
            here, there = np.median(times_s, axis=0) * 1e6
            print(
                f"  {part:<34}{variant:<20}{middle:.3f} ({low:.3f}-{high:.3f})  {here:.1f} / {there:.1f} us", flush=True
            )
    for version in versions:
        version.close()


def main() -> None:
    """Compare, or measure as the process of one version."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, nargs="?", help="the other checkout")
    parser.add_argument("--rounds", type=int, default=21)
    parser.add_argument("--part", action="append", choices=CALLS, help="default: all")
    parser.add_argument("--measure", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure:
        measure()
    elif arguments.folder is None or not (arguments.folder / "model").is_dir():
        parser.error(f"expected a folder that holds a checkout, got {arguments.folder}")
    else:
        compare(arguments.folder.resolve(), arguments.rounds, arguments.part or list(CALLS))


if __name__ == "__main__":
    main()
