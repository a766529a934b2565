"""How long `rig identify` takes on a long motion: a table of simulated tips, imported and identified.

Run: python -m benchmarks.long_motion [--frames 8000] [--seed 0] [--folder DIR]

The arm of the rig `mock-ideal` is drawn from its standard uncertainties, with a damping about 10 ms. It starts at rest
and is moved by two sines. Printed are the output of the command, which runs in a process of its own, and its wall and
processor time.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from calibration.identify.nuisance import stated_values
from calibration.identify.setup import Setup
from calibration.identify.simulated_experiments import MeasurementErrors, drawn_setup, perform, plan
from model.units import PA_PER_BAR
from rig.config.arm_model import model_arm
from rig.config.loader import load

FREE = "law,rpe_per_bar,base,damping_s,sensor_offsets"
# Of frame and row [s], and the errors of tips [m] and pressures [Pa].
PERIOD_S = 1 / 30
DAMPING_S, RISE_S = 0.01, 2.0
ERRORS = MeasurementErrors((3e-5, 3e-5, 6e-5), 20.0, 200.0)
MAPPING = """\
title: two sines
rig: mock-ideal
simulated: true
time: {column: time, unit: s}
pressures: {columns: [p1, p2, p3], unit: Pa, reading: gauge}
tip: {position: {columns: [x, y, z], unit: m}, uncertainty_mm: [0.03, 0.03, 0.06]}
"""


def write_table(file: Path, frames: int, seed: int) -> None:
    """A CSV of times, measured pressures and measured tips of a drawn arm."""
    rng = np.random.default_rng(seed)
    arm = model_arm(load("mock-ideal"))
    start = Setup(arm.with_segment(material=replace(arm.material, damping_s=DAMPING_S)))
    truth = drawn_setup(start, stated_values(start, {"damping_s": 0.2 * DAMPING_S, "sensor_filter_s": 1e-9}), rng)
    time_s = PERIOD_S * np.arange(frames)
    phase = 2 * np.pi * time_s[:, None] * np.array([0.6, 0.9, 0.9]) + np.array([0.0, 1.0, 1.0])
    growing = 1 - np.exp(-((time_s[:, None] / RISE_S) ** 2))
    pressure_pa = PA_PER_BAR * (0.05 + growing * (0.3 + 0.2 * np.sin(phase)))
    done = perform(plan("two sines", pressure_pa, period_s=PERIOD_S, errors=ERRORS), truth, rng, ERRORS)
    rows = np.column_stack([time_s, done.pressure_pa, done.tip_m])
    np.savetxt(file, rows, delimiter=",", header="time,p1,p2,p3,x,y,z", comments="", fmt="%.9g")


def main() -> None:
    """Print wall and processor time."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--frames", type=int, default=8000)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--folder", type=Path, help="keep table and archive there, and use those of an earlier call")
    given = options.parse_args()
    with tempfile.TemporaryDirectory() as own:
        folder = given.folder or Path(own)
        folder.mkdir(parents=True, exist_ok=True)
        if not (archives := sorted(folder.glob("*.h5"))):
            write_table(folder / "motion.csv", given.frames, given.seed)
            (folder / "motion.yaml").write_text(MAPPING, encoding="utf-8")
            _rig("import", "motion.csv", "--mapping", "motion.yaml", "--out", ".", folder=folder)
            archives = sorted(folder.glob("*.h5"))
        before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        print(_rig("identify", archives[0].name, "--free", FREE, folder=folder))
        took, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
        busy = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        print(f"{given.frames} frames: {took:.0f} s by the clock, {busy:.0f} s of processor time")


def _rig(*arguments: str, folder: Path) -> str:
    """Output of a command of softrig; progress goes to the error output."""
    command = [sys.executable, "-m", "rig", *arguments]
    return subprocess.run(command, cwd=folder, check=True, stdout=subprocess.PIPE, text=True).stdout


if __name__ == "__main__":
    main()
