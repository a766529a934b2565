"""`rig calibrate pressure` in real time on the mock card: however it ends, the valves are safe."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from rig.config.loader import load
from rig.hardware.vent import vent
from rig.simulator.registers import Registers, path_of
from scripts.rig_process import PATIENCE_S, child_of, write_rig

pytestmark = pytest.mark.realtime


@contextmanager
def sweeping(folder: Path, *, one_opener: bool = False) -> Iterator[tuple[subprocess.Popen[bytes], Registers]]:
    """A sweep that goes, and its card; killed at the end if it still does."""
    rig_file = write_rig(folder, one_opener=one_opener)
    loaded = load(rig_file)
    with (folder / "log").open("w") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "rig", "calibrate", "pressure", "--rig", str(rig_file), "--yes", "--no-sensors",
             "--to", str(folder / "p.yaml")],
            stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip
        device = f"{next(iter(loaded.cards.values())).device}-{process.pid}"
        try:
            _wait(lambda: path_of(device).exists(), process, folder)
            card = Registers.attach(device)
            _wait(lambda: _driven(card, 4.5), process, folder)
            yield process, card
        finally:
            process.kill()
            process.wait()
            Registers.remove(device)


def _wait(true: Callable[[], bool], process: subprocess.Popen[bytes], folder: Path) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not true():
        assert process.poll() is None, (folder / "log").read_text()
        assert time.monotonic() < deadline, (folder / "log").read_text()
        time.sleep(0.02)


def _driven(card: Registers, above_v: float) -> bool:
    """True while some output stands above a voltage, read beside the process that has the card."""
    return bool((card.outputs["value"] > above_v).any())


def _become_safe(card: Registers) -> None:
    deadline = time.monotonic() + 2.5
    while _driven(card, 0.01):
        assert time.monotonic() < deadline
        time.sleep(0.001)
    time.sleep(0.1)
    assert not _driven(card, 0.01)


def test_killed_in_the_middle_of_a_sweep_the_watchdog_vents(tmp_path: Path) -> None:
    with sweeping(tmp_path) as (process, card):
        process.kill()
        _become_safe(card)


def test_ctrl_c_ends_a_sweep_with_the_valves_vented_and_no_file(tmp_path: Path) -> None:
    with sweeping(tmp_path) as (process, card):
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 130
        assert not _driven(card, 0.01)
    assert "the valves go to their safe state" in (tmp_path / "log").read_text()
    assert not (tmp_path / "p.yaml").exists()


@pytest.mark.parametrize("one_opener", [False, True])
def test_a_sweep_that_hangs_as_soon_as_it_opens_a_valve_is_made_safe(tmp_path: Path, one_opener: bool) -> None:
    """Where the card admits one process at a time, by ending the command that has it."""
    with sweeping(tmp_path, one_opener=one_opener) as (process, card):
        process.send_signal(signal.SIGSTOP)
        _become_safe(card)
        process.send_signal(signal.SIGCONT)
        assert process.wait(PATIENCE_S) == (-signal.SIGKILL if one_opener else 1)
    assert "hung" in (tmp_path / "log").read_text()


def test_rig_vent_ends_a_sweep_and_its_valves_stay_vented(tmp_path: Path) -> None:
    with sweeping(tmp_path) as (process, card):
        vent(load(tmp_path / "rig.yaml"))
        assert process.wait(PATIENCE_S) == 130
        assert not _driven(card, 0.01)
    assert "stopped: vented by `rig vent`" in (tmp_path / "log").read_text()


def test_a_sweep_whose_watchdog_dies_ends_with_the_valves_vented(tmp_path: Path) -> None:
    with sweeping(tmp_path) as (process, card):
        os.kill(child_of(process.pid, "rig.realtime.watchdog_process"), signal.SIGKILL)
        _become_safe(card)
        assert process.wait(PATIENCE_S) == 1
    assert "the watchdog process died" in (tmp_path / "log").read_text()
