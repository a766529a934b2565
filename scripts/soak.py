"""`python -m scripts.soak`: long runs, watched for growth of memory and file handles and for what is missing.

One run in real time on the mock rig, every process of it watched; then hours of virtual time, run after run in one
process. Says what it saw in a few lines; 0 where nothing grew and nothing was missing.
"""

from __future__ import annotations

import argparse
import gc
import os
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml

import rig.config.loader
import runs
from rig.experiment import run as experiment
from rig.experiment.options import RunOptions
from rig.experiment.prepare import prepare
from runs.records import Level
from runs.run import Run
from scripts.faults.trial_run import CONTROL, SUPERVISOR, TrialRun, lives
from scripts.faults.virtual import Listener

PROTOCOL = """
title: Soak
steps:
  - ramp: {{actuators: [1, 2, 3], to_bar: 0.35, duration_s: 1}}
  - sine: {{actuators: [1, 2, 3], mean_bar: 0.35, amplitude_bar: 0.25, omega_rad_s: 1, duration_s: {duration_s}}}
"""
HOUR_S = 3600.0
POLL_S = 5.0
SLOW_CAMERA_HZ = 5
"""Pictures a second of the virtual day: a rendered picture costs ten times what a cycle does."""
GROWTH_MB, GROWTH_SHARE = 8.0, 0.03
"""What resident memory may grow by over the second half: noise of the allocator."""
FINALISING_LOOK_S = 0.05
FINALISING_MB = 100.0
"""What making the archive may take, however long the run was."""
READING_MB = 250.0
"""What reading it for the last screen may take, an hour of run: the rows are held."""


@dataclass
class Growth:
    """Memory [MB] of its own and open files of one process, look by look.

    Files that are mapped, and memory that is shared, are not its own: the journal is mapped when the archive is made.
    """

    memory_mb: list[float] = field(default_factory=list)
    files: list[int] = field(default_factory=list)

    def look(self, pid: int) -> None:
        """Sample once more; an exited process is left out."""
        try:
            _, resident, shared, *_ = map(int, Path(f"/proc/{pid}/statm").read_text().split())
            files = len(os.listdir(f"/proc/{pid}/fd"))  # noqa: PTH208
        except OSError:
            return
        self.memory_mb.append((resident - shared) * os.sysconf("SC_PAGE_SIZE") / 1e6)
        self.files.append(files)

    def verdict(self, name: str) -> tuple[bool, str]:
        """Compare the end with the middle: by then everything has been used once."""
        if len(self.memory_mb) < 4:
            return True, f"{name}: too short to judge"
        half = len(self.memory_mb) // 2
        before, after = self.memory_mb[half], float(np.median(self.memory_mb[-3:]))
        grown = after - before
        passed = grown < max(GROWTH_MB, GROWTH_SHARE * before) and max(self.files[half:]) <= max(self.files[: half + 1])
        return passed, (
            f"{name}: {before:.1f} -> {after:.1f} MB over the second half, "
            f"{self.files[half]} -> {self.files[-1]} open files{'' if passed else '  GROWS'}"
        )

    def peak(self, name: str, before: Growth, allowed_mb: float) -> tuple[bool, str]:
        """Compare the most that was taken with what the process had before."""
        if not self.memory_mb:
            return True, f"{name}: too short to see"
        most, had = max(self.memory_mb), before.memory_mb[-1]
        passed = most - had < allowed_mb
        return passed, f"{name}: peak {most:.1f} MB, {had:.1f} MB before{'' if passed else '  TOO MUCH'}"


def real(duration_s: float, stolen_s: float | None) -> bool:
    """One run in real time; `stolen_s` is for how long the host may take a processor away."""
    limits = {} if stolen_s is None else {"hung_s": stolen_s, "stale_s": max(stolen_s, 0.1)}
    with tempfile.TemporaryDirectory(prefix="softrig-soak-") as folder:
        run = TrialRun(Path(folder), protocol=PROTOCOL.format(duration_s=duration_s - 1), limits=limits)
        try:
            run.wait_until_moving().close()
            grown = {name: Growth() for name in run.members}
            finalising, reading = Growth(), Growth()
            while run.process.poll() is None:
                # The supervisor makes the archive when the others have gone, and then reads it for its last screen.
                if lives(run.members[CONTROL]):
                    for name, growth in grown.items():
                        growth.look(run.members[name])
                    time.sleep(POLL_S if duration_s > 20 * POLL_S else 0.5)
                else:
                    (reading if any(run.out.glob("*.h5")) else finalising).look(run.process.pid)
                    time.sleep(FINALISING_LOOK_S)
        finally:
            run.close()
        (archive,) = run.out.glob("*.h5")
        verdicts = [growth.verdict(name) for name, growth in grown.items()]
        verdicts.append(finalising.peak("while finalising", grown[SUPERVISOR], FINALISING_MB))
        verdicts.append(
            reading.peak(
                "while its last screen is made", grown[SUPERVISOR], max(FINALISING_MB, READING_MB * duration_s / HOUR_S)
            )
        )
        return _report(f"{duration_s:.0f} s in real time", verdicts, runs.open(archive))


def virtual(hours: float) -> bool:
    """Hours of virtual time, an hour a run."""
    growth, passed = Growth(), True
    left_s = hours * HOUR_S
    with tempfile.TemporaryDirectory(prefix="softrig-soak-") as name:
        folder = Path(name)
        rig_file, protocol = folder / "rig.yaml", folder / "protocol.yaml"
        rig_file.write_text(_mock(SLOW_CAMERA_HZ))
        while left_s > 0:
            duration_s = min(left_s, HOUR_S)
            protocol.write_text(PROTOCOL.format(duration_s=duration_s - 1))
            prepared = prepare(
                str(protocol), str(rig_file), RunOptions(out=folder / "out", fast=True, seed=int(left_s), report=False)
            )
            result = experiment.run(prepared, Listener())
            assert result.archive is not None
            passed &= _report(f"{duration_s:.0f} s in virtual time", [], runs.open(result.archive))
            for left in (folder / "out").iterdir():
                left.unlink()
            gc.collect()
            growth.look(os.getpid())
            left_s -= duration_s
    fine, said = growth.verdict("the process")
    print(f"{hours:g} h in virtual time: {said}")
    return passed and fine


def _mock(rate_hz: float) -> str:
    """The mock rig's file with its camera at another rate, few pictures of which are kept."""
    document = yaml.safe_load(rig.config.loader.text("mock"))
    for camera in document["cameras"].values():
        camera["rate_hz"] = rate_hz
    return yaml.safe_dump({**document, "recording": {"keep_every": 30}})


def _report(what: str, verdicts: list[tuple[bool, str]], run: Run) -> bool:
    pressure, timing = run.pressure, run.timing
    holes = int(np.clip(np.diff(pressure.cycle) - 1 - timing.overruns[1:], 0, None).sum())
    missed = int(timing.overruns.sum())
    stolen = timing.counters.get("stolen_cpu_ms", 0)
    complete = str(run.status) == "finished" and holes == 0 and timing.ring_overflows == 0
    print(
        f"{what}: {run.status}, {len(pressure.cycle)} cycles, {holes} missing, {missed} deadlines missed "
        f"({stolen} ms of CPU stolen by the host), {len(run.tip.time_s)} frames, {timing.dropped_frames} dropped, "
        f"{timing.ring_overflows} rows lost in rings",
        flush=True,
    )
    if run.message:
        print(f"  {run.message}", flush=True)
    for event in run.events:
        if event.level is not Level.INFO:
            print(
                f"  {(event.t_ns - run.header.started_t_ns) * 1e-9:.1f} s {event.source}: {event.message}", flush=True
            )
    for _, said in verdicts:
        print(f"  {said}", flush=True)
    return complete and all(passed for passed, _ in verdicts)


def main() -> int:
    """Soak for as long as is asked."""
    parser = argparse.ArgumentParser(prog="python -m scripts.soak", description=__doc__)
    parser.add_argument("--real-s", type=float, default=HOUR_S)
    parser.add_argument(
        "--stolen-s",
        type=float,
        help="on a virtual machine: the longest that its host takes a processor away, which from within looks like a "
        "process or a card that hangs",
    )
    parser.add_argument("--virtual-hours", type=float, default=24.0)
    options = parser.parse_args()
    passed = real(options.real_s, options.stolen_s) if options.real_s > 0 else True
    if options.virtual_hours > 0:
        passed &= virtual(options.virtual_hours)
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
