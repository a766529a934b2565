"""Time of the tip controller's steps in a run in real time, beside observer, control and recording.

    python -m benchmarks.tip_solver [--protocol tip-eight] [--period-s 2] [--periods 10] [--runs 3]

Runs the protocol on mock-3 in real time, with pictures, and prints for each run the median and the 99th percentile of
the wall time of a step as in the archive (`solve_us`), and of the processor time of the controller within it: on a
machine with other work the first contains the waiting for a processor. The controller is the horizon controller, which
also measures its thread's processor time and states it in the column `iterations` [us].
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.execution.plan import NullOperator
from rig.experiment import run as experiment
from rig.experiment.options import RunOptions
from rig.experiment.prepare import prepare
from rig.tip_control.horizon import HorizonControl
from rig.tip_control.interface import ControllerMeasurement, ReferenceTrajectory, SetPointPlan
from runs.run import Run

SETTLED_FRAMES = 30
"""First steps of a run that do not count: caches are cold."""


class TimedHorizon(HorizonControl):
    """The horizon controller with the processor time of each step [us] in place of the solver's iterations."""

    def step(self, state: Any, reference: ReferenceTrajectory, measurement: ControllerMeasurement) -> SetPointPlan:
        """As the horizon controller."""
        begun_ns = time.thread_time_ns()
        plan = super().step(state, reference, measurement)
        return plan._replace(iterations=(time.thread_time_ns() - begun_ns) // 1000)


def quantiles(values: NDArray[np.float64]) -> str:
    """Median, 99th percentile and largest value."""
    return " / ".join(f"{value:.2f}" for value in (np.median(values), np.percentile(values, 99), values.max()))


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--protocol", default="tip-eight")
    parser.add_argument("--period-s", type=float, default=2.0)
    parser.add_argument("--periods", type=int, default=10)
    parser.add_argument("--runs", type=int, default=3)
    args = parser.parse_args()
    # The process of the controller imports this module.
    os.environ["PYTHONPATH"] = str(Path(__file__).parents[1])
    print("load   steps   wall p50 / p99 / max [ms]   processor p50 / p99 / max [ms]   plan late p50 / p99 [ms]")
    for seed in range(args.runs):
        with tempfile.TemporaryDirectory() as folder:
            prepared = prepare(
                args.protocol,
                "mock-3",
                RunOptions(
                    settings={"period_s": args.period_s, "periods": args.periods},
                    out=Path(folder),
                    seed=seed,
                    report=False,
                    controller="benchmarks.tip_solver:TimedHorizon",
                ),
            )
            load, done = os.getloadavg()[0], experiment.run(prepared, NullOperator())
            if done.archive is None:
                raise SystemExit("; ".join(done.warnings) or done.outcome.message)
            plans = Run(done.archive).tip_control
        assert plans is not None
        wall, processor = 1e-3 * plans.solve_us[SETTLED_FRAMES:], 1e-3 * plans.iterations[SETTLED_FRAMES:]
        late = f"{np.median(plans.late_ms):.1f} / {np.percentile(plans.late_ms, 99):.1f}"
        print(f"{load:4.1f}  {len(wall):6}   {quantiles(wall):25}   {quantiles(processor):30}   {late}", flush=True)


if __name__ == "__main__":
    main()
