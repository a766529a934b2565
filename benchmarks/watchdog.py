"""How long until the valves are safe when the control process is killed, or hangs: measured from outside, under load.

    python -m benchmarks.watchdog [--trials 50] [--idle] [--beside 1]

Each trial is a `rig run` in real time on a mock card of its own, struck at a random moment. The time runs from just
before the signal to `written_ns` of the write that made the last output safe, read from the card's shared file by this
process. The load is one busy process per core, for each of the trials that run side by side.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import platform
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from itertools import repeat
from pathlib import Path

from scripts.faults.fault_trial import EndedBeforeError
from scripts.faults.trial_run import CONTROL, TrialRun

KINDS = {"killed": (signal.SIGKILL, 10.0), "hung": (signal.SIGSTOP, 50.0)}
"""What is done to control, and the median allowed [ms]."""
PATIENCE_S = 5.0
ATTEMPTS = 5
BUSY = "while True: pass"


@contextmanager
def _load(idle: bool) -> Iterator[None]:
    cores = 0 if idle else len(os.sched_getaffinity(0))
    hogs = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(cores)]
    try:
        yield
    finally:
        for hog in hogs:
            hog.kill()
            hog.wait()


def trial(number: signal.Signals, moment_s: float, idle: bool) -> float:
    """One run, struck; milliseconds until every output stood safe. A run that ends before is no trial."""
    for _ in range(ATTEMPTS):
        with suppress(EndedBeforeError):
            return _struck(number, moment_s, idle)
    raise RuntimeError(f"{ATTEMPTS} runs ended before they could be struck: is the machine too busy?")


def _struck(number: signal.Signals, moment_s: float, idle: bool) -> float:
    with tempfile.TemporaryDirectory(prefix="softrig-watchdog-") as folder:
        run = TrialRun(Path(folder))
        try:
            registers = run.wait_until_moving()
            with _load(idle):
                time.sleep(moment_s)
                # A trial counts where the valves are driven at the moment of the fault.
                if run.ended(registers):
                    raise EndedBeforeError
                while run.safe(registers) and run.process.poll() is None:
                    time.sleep(0.001)
                struck_ns = time.monotonic_ns()
                run.signal((CONTROL,), number)
                until = time.monotonic() + PATIENCE_S
                while not run.safe(registers):
                    if time.monotonic() > until:
                        raise RuntimeError(f"NOT SAFE after {PATIENCE_S:g} s")
                    time.sleep(0.0002)
                safe_ns = int(registers.outputs["written_ns"].max())
            registers.close()
        finally:
            run.close()
    return (safe_ns - struck_ns) * 1e-6


def main() -> int:
    """Run the trials; 0 where the medians are as promised."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--idle", action="store_true", help="without the load")
    parser.add_argument("--beside", type=int, default=1, help="trials side by side, each the other's load")
    options = parser.parse_args()
    chance = random.Random(options.seed)
    print(f"{platform.machine()}, {os.cpu_count()} cores, {'idle' if options.idle else 'one busy process per core'}")
    kept = True
    spawn = multiprocessing.get_context("spawn")
    for name, (number, allowed_ms) in KINDS.items():
        with ProcessPoolExecutor(options.beside, spawn) as pool:
            moments = [chance.uniform(0.2, 2.0) for _ in range(options.trials)]
            times = sorted(pool.map(trial, repeat(number), moments, repeat(options.idle)))
        median = statistics.median(times)
        kept &= median <= allowed_ms
        tail = times[min(len(times) - 1, round(0.95 * len(times)))]
        print(
            f"control {name}: {len(times)} trials, median {median:.1f} ms (allowed {allowed_ms:g}), "
            f"95 % {tail:.1f} ms, worst {times[-1]:.1f} ms",
            flush=True,
        )
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
