"""A run in real time on the kernel's devices: outputs looped to inputs, rendered pictures through a V4L2 camera."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from rig.config.loader import load
from rig.doctor import examine
from rig.hardware.bench import open_bench
from tests.hardware.kernel_card import COUNT_V, OpenCard, bipolar
from tests.hardware.rig_of_the_machine import LOOPED, STEPS, VALVES, Player

# An emulated machine takes a minute to import what a run needs; else this is the command line.
RIG = "import rig.realtime.supervisor as r; r.START_TIMEOUT_S = 400.0; from rig.cli.app import main; main()"


def start_run(folder: Path) -> subprocess.Popen[str]:
    """The command line as an operator would type it."""
    options = ["--rig", LOOPED, "--out", str(folder), "--yes", "--no-report"]
    command = [sys.executable, "-c", RIG, "run", STEPS, *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


@pytest.fixture
def valves_open(open_card: OpenCard) -> None:
    """Outputs that stand where a safe state has to take them away from."""
    open_card((), bipolar(*VALVES)).write(np.array([5.0, 5.0, 5.0]))


def test_a_bench_on_the_card_arms_reads_and_is_made_safe(open_card: OpenCard, valves_open: None) -> None:
    bench = open_bench(load(LOOPED))
    try:
        bench.safe_state.arm()
        np.testing.assert_allclose(bench.readback(), bench.safe_state.outputs.held, atol=COUNT_V)
        bench.start()
        bench.write(np.array([1.0, 2.0, 3.0]))
        np.testing.assert_allclose(bench.read().pressure_pa, [[1e4, 2e4, 3e4]], atol=10)
        bench.safe_state.make_safe()
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
    out: Path, tmp_path: Path, player: Player, open_card: OpenCard, valves_open: None
) -> None:
    # In the memory of the guest: a busy disk of the host would stall the run.
    run = start_run(tmp_path / "runs")
    said, _ = run.communicate(timeout=1200)
    (out / "run.txt").write_text(said)
    shutil.copytree(tmp_path / "runs", out / "runs", dirs_exist_ok=True)
    assert run.returncode == 0, said
    assert "SIMULATED" not in said
    np.testing.assert_allclose(open_card((), bipolar(*VALVES)).readback(), [0.0, 0.0, 0.0], atol=COUNT_V)
