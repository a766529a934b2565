"""Where the time of a run in virtual time goes: the whole command `rig run PROTOCOL --fast`, report included.

    python -m benchmarks.virtual [--protocol ramp-a] [--times 3] [--parts]

The command is run as a process of its own and timed from outside, several times; best and median are reported. With
`--parts` it is run once more in this process with a stopwatch at every part. Processor time is printed beside: on a
busy machine it is the steadier of the two. Frames are rendered and measured in a process beside control, and the
report's process loads its libraries meanwhile, so the parts add up to more than the run.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.support.inline_pipeline import InlinePipeline


class Stopwatch:
    """Adds up the processor time of the calling thread inside functions, without what is inside others of them."""

    def __init__(self) -> None:
        self.spent_s: dict[str, float] = {}
        self._inside: list[list[float]] = []

    def around(self, owner: Any, name: str, part: str) -> None:
        """Time a function or method from now on, as a part of the run."""
        timed: Callable[..., Any] = getattr(owner, name)

        def stopped(*arguments: Any, **named: Any) -> Any:
            within = [0.0]
            self._inside.append(within)
            begun = time.thread_time()
            try:
                return timed(*arguments, **named)
            finally:
                took = time.thread_time() - begun
                self._inside.pop()
                self.spent_s[part] = self.spent_s.get(part, 0.0) + took - within[0]
                if self._inside:
                    self._inside[-1][0] += took

        setattr(owner, name, stopped)


def whole(protocol: str, times: int) -> None:
    """Time the command from outside."""
    walls, spent = [], []
    for _ in range(times):
        with tempfile.TemporaryDirectory() as folder:
            before, begun = os.times(), time.perf_counter()
            command = [
                sys.executable,
                "-P",
                "-m",
                "rig",
                "run",
                protocol,
                "--fast",
                "--seed",
                "1",
                "--yes",
                "--out",
                folder,
            ]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            walls.append(time.perf_counter() - begun)
            after = os.times()
            (archive,) = Path(folder).glob("*.h5")
            lasted = _duration_s(archive)
        spent.append(after.children_user + after.children_system - before.children_user - before.children_system)
    for name, wall in (("best", min(walls)), ("median", statistics.median(walls))):
        print(f"{protocol}, {name}: {lasted:.0f} s of experiment in {wall:.2f} s, {lasted / wall:.1f} times as fast")
    print(f"processor time, median: {statistics.median(spent):.2f} s")


def _duration_s(archive: Path) -> float:
    from runs.run import Run

    return Run(archive).duration_s


def parts(protocol: str) -> None:
    """Time the parts of a run in this process."""
    begun = time.process_time()
    from rig.cli import run_output, terminal  # noqa: F401 - what the command imports
    from rig.control import control_loop
    from rig.execution.plan import NullOperator
    from rig.experiment import report_process
    from rig.experiment import run as experiment
    from rig.experiment.options import RunOptions
    from rig.experiment.prepare import prepare
    from rig.observation import picture_recorder
    from rig.observation.camera_estimator import CameraTipEstimator
    from rig.observation.live_model import LiveModel
    from rig.observation.observer import Observer
    from rig.realtime.data_recorder import DataRecorder
    from rig.simulator.mock_camera import MockCamera
    from rig.simulator.plant import Plant
    from rig.virtual import executor
    from runs.archive import writer

    imports_s = time.process_time() - begun
    watch = Stopwatch()
    executor.FramePipeline = InlinePipeline  # type: ignore[misc,assignment]
    watch.around(executor._VirtualRun, "__init__", "start")
    watch.around(executor._VirtualRun, "_cycle", "the loop itself")
    watch.around(control_loop.ControlLoop, "cycle", "control")
    watch.around(Plant, "advance", "plant")
    watch.around(MockCamera, "expose", "exposure")
    watch.around(MockCamera, "develop", "rendering")
    watch.around(Observer, "step", "observer, the rest")
    watch.around(CameraTipEstimator, "measure", "vision")
    watch.around(LiveModel, "step", "model")
    watch.around(picture_recorder.PictureRecorder, "pictures", "pictures stored")
    watch.around(DataRecorder, "drain", "recording")
    watch.around(writer, "finalise", "archive")
    watch.around(report_process, "write_here", "report")
    with tempfile.TemporaryDirectory() as folder:
        prepared = prepare(protocol, "mock", RunOptions(out=Path(folder), fast=True, seed=1, report=False))
        begun = time.process_time()
        left = experiment.run(prepared, NullOperator())
        assert left.archive is not None
        report_process.write_here(left.archive)
        spent = time.process_time() - begun
        result = {"imports": imports_s, **watch.spent_s}
    result["else"] = spent - sum(watch.spent_s.values())
    print(f"\n{'part':24s}{'s':>8s}{'% of all':>10s}")
    for part, part_s in result.items():
        print(f"{part:24s}{part_s:8.2f}{100 * part_s / (imports_s + spent):10.1f}")
    outside = sum(result[part] for part in ("imports", "start", "archive", "report", "else"))
    loop_s = imports_s + spent - outside
    print(f"{'the whole loop':24s}{loop_s:8.2f}, {prepared.plan.trajectory.duration_s / loop_s:.1f} times real time")


def main() -> None:
    """Parse the command line and measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--protocol", default="ramp-a")
    parser.add_argument("--times", type=int, default=3, help="how often; 0 leaves this out")
    parser.add_argument("--parts", action="store_true")
    options = parser.parse_args()
    if options.times:
        whole(options.protocol, options.times)
    if options.parts:
        parts(options.protocol)


if __name__ == "__main__":
    main()
