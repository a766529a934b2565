"""`rig calibrate pressure` in real time on the mock card: however it ends, the valves are safe."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from rig import config
from rig.bench import open_bench
from rig.daq.base import CardError
from rig.rig_file import load
from tests.rig_process import PATIENCE_S, write_rig

pytestmark = pytest.mark.alone


@contextmanager
def sweeping(folder: Path) -> Iterator[tuple[subprocess.Popen[bytes], config.RigConfig]]:
    """A sweep that goes; killed at the end if it still does."""
    rig_file = write_rig(folder)
    loaded = load(rig_file)
    with (folder / "log").open("w") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "rig", "calibrate", "pressure", "--rig", str(rig_file), "--yes", "--no-sensors",
             "--to", str(folder / "p.yaml")],
            stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip
        try:
            _wait(lambda: _outputs(loaded, 4.5), process, folder)
            yield process, loaded
        finally:
            process.kill()
            process.wait()


def _wait(true: Callable[[], bool], process: subprocess.Popen[bytes], folder: Path) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not true():
        assert process.poll() is None, (folder / "log").read_text()
        assert time.monotonic() < deadline, (folder / "log").read_text()
        time.sleep(0.02)


def _outputs(loaded: config.RigConfig, above_v: float) -> bool:
    """True once some output stands above a voltage."""
    try:
        bench = open_bench(loaded, watchdog=True)
    except CardError:
        return False
    try:
        return bool((bench.readback() > above_v).any())
    finally:
        bench.close()


def _become_safe(loaded: config.RigConfig) -> None:
    bench = open_bench(loaded, watchdog=True)
    try:
        deadline = time.monotonic() + 2.5
        while (bench.readback() > 0.01).any():
            assert time.monotonic() < deadline, bench.readback()
            time.sleep(0.001)
        time.sleep(0.1)
        assert not (bench.readback() > 0.01).any()
    finally:
        bench.close()


def test_killed_in_the_middle_of_a_sweep_the_watchdog_vents(tmp_path: Path) -> None:
    with sweeping(tmp_path) as (process, loaded):
        process.kill()
        _become_safe(loaded)


def test_ctrl_c_ends_a_sweep_with_the_valves_vented_and_no_file(tmp_path: Path) -> None:
    with sweeping(tmp_path) as (process, loaded):
        bench = open_bench(loaded, watchdog=True)
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 130
        bench.close()
    assert "the valves are in their safe state" in (tmp_path / "log").read_text()
    assert not (tmp_path / "p.yaml").exists()
