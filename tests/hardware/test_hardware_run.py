"""A run in real time on the kernel's devices: outputs looped to inputs, rendered pictures through a V4L2 camera."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from kernel_card import COUNT_V, OpenCard, bipolar
from rig_of_the_machine import LOOPED, STEPS, VALVES, Player

from rig.bench import open_bench
from rig.doctor import examine
from rig.rig_file import load

# An emulated machine takes a minute to import what a run needs; else this is the command line.
RIG = "import rig.executor.realtime as r; r.START_TIMEOUT_S = 400.0; from rig.cli import main; main()"


def start_run(folder: Path) -> subprocess.Popen[str]:
    """The command line as an operator would type it."""
    options = ["--rig", LOOPED, "--out", str(folder), "--yes", "--no-report"]
    command = [sys.executable, "-c", RIG, "run", STEPS, *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


@pytest.fixture
def valves_open(open_card: OpenCard) -> None:
    """Outputs that stand where a safe state has to take them away from."""
    open_card((), bipolar(*VALVES)).write(np.array([5.0, 5.0, 5.0]))


def test_a_bench_of_the_card_arms_reads_and_is_made_safe(open_card: OpenCard, valves_open: None) -> None:
    bench = open_bench(load(LOOPED))
    try:
        bench.arm()
        np.testing.assert_allclose(bench.readback(), bench.safe_voltages, atol=COUNT_V)
        bench.start()
        bench.write(np.array([1.0, 2.0, 3.0]))
        np.testing.assert_allclose(bench.read().pressure_pa, [[1e4, 2e4, 3e4]], atol=10)
        bench.make_safe()
    finally:
        bench.close()
    np.testing.assert_allclose(open_card((), bipolar(*VALVES)).readback(), [0.0, 0.0, 0.0], atol=COUNT_V)


def test_doctor_finds_the_card_its_binding_and_the_cameras(tmp_path: Path) -> None:
    found = {(f.topic, f.verdict): f.found for f in examine(tmp_path, load(LOOPED))}
    assert found["card", "ok"].startswith(
        "/dev/comedi0: comedi_test, driver comedi_test; 8 analogue in, 8 analogue out"
    )
    assert "8 of 16 bit (-10 to 10 V, -5 to 5 V)" in found["card inputs", "ok"]
    assert "drivers loaded: comedi_test" in found["Comedi", "ok"]
    assert "0 V" in found["power-up", "note"]
    assert "3 of 8 outputs used, 5 left" in found["rig's card daq", "ok"]
    assert ("pycomedi", "ok") in found
    assert "/dev/video0" in " ".join(f.found for f in examine(tmp_path) if f.topic == "camera")


def test_a_run_to_the_end_leaves_its_archive_and_safe_valves(
    out: Path, player: Player, open_card: OpenCard, valves_open: None
) -> None:
    run = start_run(out / "runs")
    said, _ = run.communicate(timeout=600)
    (out / "run.txt").write_text(said)
    assert run.returncode == 0, said
    assert "SIMULATED" not in said
    np.testing.assert_allclose(open_card((), bipolar(*VALVES)).readback(), [0.0, 0.0, 0.0], atol=COUNT_V)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_run_that_is_stopped_or_killed_leaves_safe_valves(
    tmp_path: Path, player: Player, open_card: OpenCard, number: signal.Signals
) -> None:
    watching = open_card((), bipolar(*VALVES))
    run = start_run(tmp_path)
    until = time.monotonic() + 500
    while not watching.readback().max() > 0.5:
        assert run.poll() is None, run.communicate()[0]
        assert time.monotonic() < until, "no valve moved"
        time.sleep(0.02)
    os.kill(run.pid, number)
    until = time.monotonic() + 20
    while watching.readback().max() > COUNT_V and time.monotonic() < until:
        time.sleep(0.01)
    np.testing.assert_allclose(watching.readback(), [0.0, 0.0, 0.0], atol=COUNT_V)
    assert run.stdout is not None
    run.stdout.close()
    run.wait(timeout=60)
    until = time.monotonic() + 60
    while (left := processes_of_runs()) and time.monotonic() < until:
        time.sleep(0.2)
    assert left == []


def processes_of_runs() -> list[str]:
    """Command lines of the processes of any run."""
    lines = []
    for file in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            line = file.read_bytes().replace(b"\0", b" ").decode()
        except OSError:
            continue
        if "rig.executor" in line:
            lines.append(line)
    return lines
