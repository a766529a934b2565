"""A run on the serial driver: the reference firmware behind a pseudo-terminal, `rig run` at 200 Hz in real time.

    python -m benchmarks.serial_run [--minutes 10] [--hung-s 0.03]

Prints cycles, missed deadlines and lateness of control, the load of the machine, and the changes of the controller's
state (2: it vented by itself). The controller is a process of this computer, compiled by g++.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import runs
from scripts.pressure_controller import compiled, controller
from scripts.serial_rig import serial_text

PROTOCOL = """title: Three sinusoids
steps:
  - sine: {{actuators: [1, 2, 3], mean_bar: 0.3, amplitude_bar: 0.2, period_s: 4, phase_deg: [0, 120, 240],
           duration_s: {seconds:g}, lead_in_s: 2}}
  - ramp: {{actuators: [1, 2, 3], to_bar: 0, duration_s: 2}}
"""


def main() -> None:
    """Run once and print the figures."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--minutes", type=float, default=10.0)
    options.add_argument("--hung-s", type=float, help="limits.hung_s; a virtual machine may need more than 0.03")
    arguments = options.parse_args()
    with tempfile.TemporaryDirectory(prefix="softrig-serial-") as name:
        folder = Path(name)
        with controller(compiled(folder), folder) as board:
            hung = f"  hung_s: {arguments.hung_s:g}\n" if arguments.hung_s else ""
            (folder / "rig.yaml").write_text(serial_text(board.device).replace("limits:\n", "limits:\n" + hung))
            (folder / "protocol.yaml").write_text(PROTOCOL.format(seconds=60 * arguments.minutes))
            loads = [os.getloadavg()[0]]
            command = [sys.executable, "-m", "rig", "run", str(folder / "protocol.yaml"), "--yes", "--no-report"]
            command += ["--rig", str(folder / "rig.yaml"), "--out", str(folder / "out")]
            ended = subprocess.run(command, capture_output=True, text=True, check=False)
            loads.append(os.getloadavg()[0])
            found = [*(folder / "out").glob("*.h5")]
            if not found:
                sys.exit(ended.stdout + ended.stderr)
            archive = runs.open(found[0])
            states = board.states()
        timing, time_s = archive.timing, archive.pressure.time_s
        late_us = timing.lateness_us
        print(f"cores {os.cpu_count()}, load before and after {loads[0]:.1f}, {loads[1]:.1f}")
        print(f"cycles {len(time_s)} in {time_s[-1]:.0f} s, missed deadlines {int(timing.overruns.sum())}")
        p50, p99, p999, largest = np.percentile(late_us, [50, 99, 99.9, 100])
        print(f"lateness p50 {p50:.0f}, p99 {p99:.0f}, p99.9 {p999:.0f}, max {largest:.0f} us")
        print(f"ring overflows {timing.ring_overflows}; {archive.status}: {archive.message}")
        print(f"states of the controller, with the time since the last byte [us]: {states}")
        # What the host of a virtual machine took is in the last lines.
        print("\n".join(ended.stdout.splitlines()[-4:]))


if __name__ == "__main__":
    main()
