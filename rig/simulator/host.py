"""Starts the plant process of a rig with mock devices, and stops it again."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rig.config import RigConfig
from rig.daq.base import CardError


@contextmanager
def simulated(config: RigConfig, rig_file: Path, seed: int) -> Iterator[subprocess.Popen[str] | None]:
    """Keep the plant running behind the rig's mock devices; None for a rig that has none.

    Raises:
        CardError: the plant did not start.
    """
    if not config.simulated:
        yield None
        return
    command = [sys.executable, "-m", "rig.simulator.process", "--rig", str(rig_file), "--seed", str(seed)]
    process = subprocess.Popen(
        [*command, "--parent", str(os.getpid())],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdout is not None
    try:
        if process.stdout.readline().strip() != "ready":
            raise CardError(f"the simulator did not start (exit status {process.wait()})")
        yield process
    finally:
        process.terminate()
        try:
            process.wait(5.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()
