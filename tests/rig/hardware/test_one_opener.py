"""A card that admits one process at a time is made safe after its holder has been ended."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import rig.config.loader
import runs
from protocols import BadInputError, SetPointTrajectory
from rig.config.schema import RigConfig
from rig.execution.plan import RunPlan
from rig.hardware.bench import open_bench
from rig.hardware.cards.base import CardBusyError
from rig.hardware.safe_state import RigSafeState, open_safe_state
from rig.hardware.vent import vent
from rig.realtime.child_process import ChildJob, ended_within, spawn
from rig.realtime.failsafe import force_safe_state
from rig.realtime.shared_state import SharedState, Stage
from rig.simulator.registers import Registers, path_of
from runs.records import Status
from scripts.rig_process import BRIEF, SHORT, rig_run, with_one_opener
from tests.support.mock_registers import mock_registers
from tests.support.waiting import wait_until

HOLD = (
    "import sys, time\nimport rig.config.loader\nfrom rig.hardware.bench import open_bench\n"
    "bench = open_bench(rig.config.loader.load(sys.argv[1]))\nprint('held', flush=True)\ntime.sleep(60)\n"
)


def rig_text(device: str, *, one_opener: bool = True) -> str:
    text = rig.config.loader.text("mock").replace("device: mock0", f"device: {device}")
    return with_one_opener(text, one_opener=one_opener)


@pytest.fixture
def device() -> Iterator[str]:
    name = f"door-{os.getpid()}"
    with mock_registers(name, 7.0):
        yield name
    path_of(name).with_suffix(".open").unlink(missing_ok=True)


@pytest.fixture
def config(device: str) -> RigConfig:
    return rig.config.loader.parse(rig_text(device), "rig.yaml")


@pytest.fixture
def holder(device: str, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that has the card, and keeps it."""
    file = tmp_path / "rig.yaml"
    file.write_text(rig_text(device))
    with subprocess.Popen([sys.executable, "-c", HOLD, file], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def volts(device: str) -> list[float]:
    registers = Registers.attach(device)
    stand: list[float] = registers.outputs["value"].tolist()
    registers.close()
    return stand


def test_a_second_opener_is_refused_with_the_holder(config: RigConfig) -> None:
    first = open_bench(config)
    with pytest.raises(CardBusyError, match=f"one process at a time and is open already by process {os.getpid()}"):
        open_safe_state(config, *config.cards)
    first.close()
    open_bench(config).close()


def test_the_watchdog_releases_a_one_opener_card_and_opens_it_to_write(config: RigConfig, device: str) -> None:
    watchdog = RigSafeState(config)
    watchdog.keep_open()
    assert not watchdog.kept_open
    control = open_bench(config)
    with pytest.raises(CardBusyError):
        watchdog.make_safe(vent=False)
    control.close()
    watchdog.make_safe(vent=False)
    assert volts(device) == [0.0, 0.0]
    watchdog.close()


def test_the_watchdog_keeps_any_other_card_open(device: str) -> None:
    config = rig.config.loader.parse(rig_text(device, one_opener=False), "rig.yaml")
    watchdog = RigSafeState(config)
    watchdog.keep_open()
    assert watchdog.kept_open
    control = open_bench(config)
    watchdog.make_safe(vent=False)
    assert volts(device) == [0.0, 0.0]
    control.close()
    watchdog.close()


def test_the_watchdog_does_not_open_a_card_that_has_no_outputs(device: str) -> None:
    with mock_registers(f"{device}-inputs", 0.0):
        text = rig_text(device, one_opener=False).replace(
            "cards:\n",
            f"cards:\n  aux: {{driver: mock, device: {device}-inputs, sampling_hz: 1000, inputs: 8, outputs: 0, "
            "one_opener: true}\n",
        )
        config = rig.config.loader.parse(text, "rig.yaml")
        assert set(config.cards) == {"aux", "daq"}
        watchdog = RigSafeState(config)
        watchdog.keep_open()
        assert watchdog.kept_open
        watchdog.close()


def test_the_failsafe_ends_the_process_that_has_the_card(
    config: RigConfig, device: str, holder: subprocess.Popen[str]
) -> None:
    memory = SharedState.create(config)
    memory.control_pid = holder.pid
    assert force_safe_state(config, memory) == ""
    assert volts(device) == [0.0, 0.0]
    assert memory.safe_ns
    os.close(memory.fd)


def test_rig_vent_ends_the_process_that_has_the_card(
    config: RigConfig, device: str, holder: subprocess.Popen[str]
) -> None:
    vent(config)
    assert volts(device) == [0.0, 0.0]
    assert holder.wait(10) == -signal.SIGKILL


def test_one_opener_is_refused_for_a_real_card() -> None:
    text = rig.config.loader.text("pci1716").replace("device: /dev/comedi0", "device: /dev/comedi0, one_opener: true")
    with pytest.raises(BadInputError, match="one_opener"):
        rig.config.loader.parse(text, "rig.yaml")


@pytest.mark.slow
def test_a_hung_holder_of_the_card_is_ended_though_another_process_is_monitored(
    config: RigConfig, device: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """As in a calibration, which drives the valves in the operator's own command."""
    memory = SharedState.create(config)
    nothing = SetPointTrajectory(0.0, config.actuators, (), (), "")
    plan = RunPlan(config, tmp_path / "rig.yaml", nothing, config.model.variant, 0)
    plan.rig_file.write_text(rig_text(device))
    watchdog = spawn("rig.realtime.watchdog_process", ChildJob(plan, memory.fd, os.getpid()))
    try:
        wait_until(lambda: memory.stage("watchdog") is Stage.READY)
        program = [sys.executable, "-c", HOLD, str(plan.rig_file)]
        with (
            subprocess.Popen(program, stdout=subprocess.PIPE) as holder,
            subprocess.Popen(["sleep", "60"]) as watched,
        ):
            assert holder.stdout is not None
            assert holder.stdout.readline() == b"held\n"
            memory.card_holder_pid = holder.pid
            memory.control_pid = watched.pid
            memory.publish_stage("control", Stage.RUNNING)
            wait_until(lambda: bool(memory.watchdog_trip_ns))
            assert volts(device) == [0.0, 0.0]
            assert holder.wait(10) == -signal.SIGKILL
            watched.kill()
        assert ended_within(watchdog, 10)
    finally:
        watchdog.kill()
        watchdog.wait()
        os.close(memory.fd)
    assert "the control process hung: the process that held the card was ended" in capfd.readouterr().err


@pytest.mark.realtime
def test_a_one_opener_card_is_made_safe_when_control_hangs(tmp_path: Path) -> None:
    with rig_run(tmp_path, SHORT, one_opener=True) as run:
        run.wait_until_pressurised()
        os.kill(run.pid_of("rig.realtime.control_process"), signal.SIGSTOP)
        run.wait_until_safe(2.0)
        assert run.end() == 1, run.output
    archive = runs.open(run.archive())
    assert archive.status is Status.ABORTED
    assert "control process hung" in archive.message


@pytest.mark.realtime
def test_a_run_on_a_one_opener_card_finishes(tmp_path: Path) -> None:
    with rig_run(tmp_path, BRIEF, one_opener=True) as run:
        assert run.end() == 0, run.output
    assert runs.open(run.archive()).status is Status.FINISHED
