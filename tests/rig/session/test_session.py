"""Runs from Python: the same rules, archives and errors as on the command line."""

from __future__ import annotations

import itertools
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import protocols
import rig
import runs
from protocols import BadInputError
from rig.config.schema import RigConfig
from rig.execution.plan import Progress
from rig.identify import identify
from rig.session.operators import FunctionOperator
from rig.session.session import RunEndedError, RunInterruptedError, Session
from runs.archive.checked import ArchiveError
from runs.records import Event
from runs.run import Run
from tests.support.command_line import status_of

PROTOCOL = """\
title: One step
parameters:
  peak_bar: {default: 0.1, unit: bar, lowest: 0, highest: 0.3}
steps:
  - ramp: {actuators: [1], to_bar: peak_bar, duration_s: 0.2}
  - hold: {duration_s: 0.5}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("session")
    (place / "step.yaml").write_text(PROTOCOL)
    return place


@pytest.fixture(scope="module")
def step(folder: Path) -> Run:
    with rig.open("mock") as bench:
        return bench.run(
            folder / "step.yaml", settings={"peak_bar": 0.2}, fast=True, seed=3, out=folder / "data", report=False
        )


def test_the_package_is_cheap_to_import() -> None:
    program = "import sys, rig, runs; print(sorted({'numpy', 'h5py', 'numba', 'pydantic', 'cv2'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True).stdout == "[]\n"


def test_a_run_is_that_of_the_command_line(step: Run, folder: Path) -> None:
    out = folder / "command"
    command = ["run", str(folder / "step.yaml"), "--out", str(out), "--set", "peak_bar=0.2", "--seed", "3"]
    assert status_of(*command, "--rig", "mock", "--fast", "--yes", "--no-report") == 0
    (archive,) = out.glob("*.h5")
    other = runs.open(archive)
    assert np.array_equal(step.tip.measured_mm, other.tip.measured_mm, equal_nan=True)
    assert np.array_equal(step.pressure.measured_bar, other.pressure.measured_bar)
    assert step.header.seed == other.header.seed == 3
    assert step.header.metadata == other.header.metadata


def test_a_run_knows_its_arm_and_its_summary(step: Run) -> None:
    assert step.arm["youngs_modulus"].unit == "Pa"
    assert step.summary.status == "finished"


def test_runs_are_opened_by_name(step: Run, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    assert runs.open("last").sha256 == step.sha256
    assert runs.open(step.header.run_id).sha256 == step.sha256
    with pytest.raises(ArchiveError, match="no such archive"):
        runs.open("nothing")


def test_a_protocol_made_of_steps_runs_without_a_file(folder: Path) -> None:
    steps = [{"ramp": {"actuators": [1], "to_bar": 0.1, "duration_s": 0.2}}, {"hold": {"duration_s": 0.2}}]
    made = protocols.from_steps("Up", steps)
    with rig.open("mock") as bench:
        assert bench.check(made).trajectory.duration_s == pytest.approx(0.4)
        run = bench.run(made, fast=True, out=folder / "made", report=False)
        with pytest.raises(BadInputError, match="--set"):
            bench.run(made, settings={"peak_bar": 0.2}, fast=True, out=folder / "none")
    assert run.header.title == "Up"
    assert run.header.protocol_yaml == made.text
    assert run.pressure.setpoint_bar[:, 0].max() == pytest.approx(0.1)


@pytest.mark.realtime
def test_a_script_streams_to_its_own_run(folder: Path) -> None:
    stream = {"actuators": [1, 2, 3], "duration_s": 2, "timeout_s": 1}
    made = protocols.from_steps("Streamed", [{"stream": stream}, {"hold": {"duration_s": 1}}])
    with rig.open("mock-3") as bench, ThreadPoolExecutor(1) as thread:
        running = thread.submit(bench.run, made, out=folder / "streamed", report=False)
        while not bench.socket.is_socket() and not running.done():
            time.sleep(0.02)
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as control:
            control.connect(str(bench.socket))

            def ask(**packet: object) -> Any:
                control.send(json.dumps(packet).encode())
                return json.loads(control.recv(4096))

            while not ask(do="state")["stream"]:
                time.sleep(0.02)
            for sequence in itertools.count():
                if not ask(do="stream", sequence=sequence, setpoint_bar=[0.1, 0.1, 0.2])["stream"]:
                    break
                time.sleep(0.02)
        streamed = running.result().streamed
    assert streamed is not None
    assert np.nanmax(streamed.setpoint_bar, axis=0).tolist() == pytest.approx([0.1, 0.1, 0.2])


def test_everything_wrong_with_a_run_is_reported_before_it(folder: Path) -> None:
    with rig.open("mock") as bench, pytest.raises(BadInputError) as wrong:
        bench.run(folder / "step.yaml", settings={"peak_bar": 9.0}, fast=True, out=folder / "none")
    assert "peak_bar" in str(wrong.value)
    assert not (folder / "none").exists()


def test_a_rig_that_is_not_open_runs_nothing(folder: Path) -> None:
    with rig.open("mock") as bench:
        assert bench.check(folder / "step.yaml").trajectory.duration_s == pytest.approx(0.7)
    with pytest.raises(BadInputError, match="open it first"):
        bench.run(folder / "step.yaml", fast=True, out=folder / "none")


def test_real_valves_are_armed_only_on_request(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RigConfig, "has_real_valves", True)
    with rig.open("mock") as bench, pytest.raises(BadInputError, match="yes=True"):
        bench.run(folder / "step.yaml", fast=True, out=folder / "none")


def test_a_prompt_in_real_time_needs_an_answer(folder: Path) -> None:
    protocol = folder / "prompt.yaml"
    protocol.write_text(PROTOCOL + "  - prompt: {message: attach the weight}\n")
    with rig.open("mock") as bench, pytest.raises(BadInputError, match="answer=input"):
        bench.run(protocol, out=folder / "none")


def test_an_error_during_a_run_ends_it_with_an_archive(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(operator: FunctionOperator, event: Event) -> None:
        raise ValueError(f"no place for {event.source}")

    monkeypatch.setattr(FunctionOperator, "report", fail)
    with rig.open("mock") as bench, pytest.raises(RunEndedError, match="no place for control") as ended:
        bench.run(folder / "step.yaml", fast=True, out=folder / "faults", report=False)
    assert ended.value.result.archive is not None
    assert runs.open(ended.value.result.archive).status == "aborted"


def test_the_answer_to_a_prompt_does_not_block_the_run() -> None:
    release, asked = threading.Event(), threading.Event()

    def answer(message: str) -> None:
        assert message == "attach the weight"
        asked.set()
        release.wait()

    operator = FunctionOperator(lambda: None, answer)
    shown = Progress(0.0, 1.0, None, None, 0, 0, "attach the weight")
    operator.show(shown)
    operator.show(shown)
    assert asked.wait(60)
    assert not operator.answered()
    release.set()
    while not operator.answered():
        time.sleep(0.001)
    assert not operator.answered()


def test_a_prompt_that_cannot_be_answered_stops_the_run() -> None:
    operator = FunctionOperator(lambda: None, lambda message: 1 / 0)
    operator.show(Progress(0.0, 1.0, None, None, 0, 0, "attach the weight"))
    while (reason := operator.stop_requested()) is None:
        time.sleep(0.001)
    assert "ZeroDivisionError" in reason


def test_ctrl_c_ends_a_run_and_the_loop_around_it(folder: Path) -> None:
    (folder / "long.yaml").write_text(PROTOCOL.replace("duration_s: 0.5", "duration_s: 600"))

    def interrupt() -> None:
        out = folder / "interrupted"
        while not list(out.glob("*.mcap")):
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    before = signal.getsignal(signal.SIGINT)
    thread.start()
    with rig.open("mock") as bench, pytest.raises(RunInterruptedError) as ended:
        bench.run(folder / "long.yaml", fast=True, out=folder / "interrupted", report=False)
    thread.join()
    assert signal.getsignal(signal.SIGINT) is before
    assert not isinstance(ended.value, Exception)
    assert ended.value.result.archive is not None
    assert runs.open(ended.value.result.archive).status == "interrupted"


def test_the_model_alone_runs_too(folder: Path) -> None:
    assert Session("mock").simulate(folder / "step.yaml", out=folder / "alone").summary is not None


def test_identification_checks_its_options_as_the_command_does(step: Run) -> None:
    with pytest.raises(BadInputError, match="--quasi-static"):
        identify([step], every=3)
    with pytest.raises(BadInputError, match="every run is left out"):
        identify([step], leave_out=[step.path])


@pytest.mark.slow
def test_the_example_of_the_guide_runs(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = Path(__file__).parents[3] / "docs" / "how-to" / "run-from-python.md"
    example = page.read_text().split("```python\n")[1].split("```")[0]
    assert '"ramp-a"' in example
    monkeypatch.chdir(folder)
    names: dict[str, Run] = {}
    exec(example.replace("ramp-a", "step.yaml").replace("fast=True", "fast=True, report=False"), names)
    assert names["run"].header.seed == 1
