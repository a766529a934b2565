"""A Dask cluster started by its command lines: a study and an identification finish, also if a worker is killed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from runs.catalogue import catalogue

PATIENCE_S = 300.0
WORKERS = 3
DASK = Path(sys.executable).with_name("dask")
PROTOCOL = """\
title: One step
parameters:
  peak_bar: {default: 0.1, unit: bar, lowest: 0, highest: 0.3}
steps:
  - ramp: {actuators: [1], to_bar: peak_bar, duration_s: 0.5}
  - hold: {duration_s: 1}
"""
PLAN = "title: Peaks\nprotocol: step.yaml\nfactors: {peak_bar: [0.1, 0.15, 0.2]}\nrepeats: 2\n"


@contextmanager
def command(*words: object) -> Iterator[subprocess.Popen[bytes]]:
    """A command of Dask that runs until the end of the context."""
    process = subprocess.Popen([DASK, *map(str, words)], stderr=subprocess.DEVNULL, start_new_session=True)
    try:
        yield process
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    """The address of a scheduler with a worker as `dask worker` starts it, and with two more of one thread each."""
    pytest.importorskip("distributed")
    file = tmp_path / "scheduler.json"
    place = ("--scheduler-file", file, "--no-dashboard")
    with (
        command("scheduler", "--host", "127.0.0.1", "--port", "0", *place),
        command("worker", *place, "--local-directory", tmp_path),
        command("worker", *place, "--local-directory", tmp_path, "--nworkers", "2", "--nthreads", "1"),
    ):
        yield str(_when(lambda: json.loads(file.read_text())["address"]))


def _when(look: object) -> object:
    """The result of a call once it raises no error."""
    deadline = time.monotonic() + PATIENCE_S
    while True:
        try:
            return look()  # type: ignore[operator]
        except (OSError, ValueError, StopIteration):
            assert time.monotonic() < deadline
            time.sleep(0.05)


def rig(folder: Path, *words: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "rig", *words], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


def ended(process: subprocess.Popen[str]) -> str:
    output, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, output
    return output


def worker_of(address: str) -> int:
    """The process of a worker, once all have joined the scheduler."""
    program = (
        "import distributed, os, sys\n"
        "with distributed.Client(sys.argv[1]) as client:\n"
        "    client.wait_for_workers(int(sys.argv[2]))\n"
        "    print(max(client.run(os.getpid).values()))"
    )
    said = subprocess.run(
        [sys.executable, "-c", program, address, str(WORKERS)], check=True, capture_output=True, text=True
    ).stdout
    return int(said)


@pytest.mark.slow
def test_a_study_and_an_identification_finish_on_a_cluster_though_a_worker_is_killed(
    address: str, tmp_path: Path
) -> None:
    (tmp_path / "step.yaml").write_text(PROTOCOL)
    (tmp_path / "peaks.yaml").write_text(PLAN)
    victim = worker_of(address)
    study = rig(tmp_path, "study", "peaks.yaml", "--fast", "--yes", "--scheduler", address, "--out", "data")
    _when(lambda: next((tmp_path / "data").glob("*.h5")))
    os.kill(victim, signal.SIGKILL)
    ended(study)
    entries = catalogue(tmp_path / "data")
    assert [entry.problem for entry in entries] == [""] * 6
    assert sorted(entry.study_number or 0 for entry in entries) == [1, 2, 3, 4, 5, 6]

    newest = str(tmp_path / "data" / entries[0].file)
    compare = ("identify", "compare", newest, "--between", "homogeneous+rpe", "inhomogeneous+rpe", "--quasi-static")
    assert "Decision" in ended(rig(tmp_path, *compare, "--scheduler", address))
