"""The start of a real-time run: warm-up on scans, calendar anchor at the first cycle, refusals."""

from __future__ import annotations

import os
import pickle
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rig.control import step as control
from rig.execution.plan import NullOperator, RunPlan, StartError
from rig.experiment import run as experiment
from rig.experiment.prepare import prepare
from rig.hardware import runtime_folder
from rig.hardware.bench import BenchScans
from rig.hardware.cards.base import CardError
from rig.realtime import child_process, control_process, process_group, supervisor
from rig.realtime.child_process import ChildJob
from rig.realtime.control_socket import ControlSocket, socket_of, socket_paths
from rig.realtime.process_group import ProcessGroup
from rig.realtime.shared_state import SharedState, Stage, Stop
from rig.realtime.stream_receiver import StreamReceiver
from rig.realtime.timing_limits import TimingLimits, TimingProfile
from rig.simulator.plant_launcher import PlantProcess
from runs.records import Event
from tests.support.child_programs import SLEEPS, child


class SlowBench:
    """A bench whose first scans arrive late."""

    def __init__(self, actuators: int) -> None:
        self._actuators = actuators
        self._looks = 0

    def read(self) -> BenchScans:
        self._looks += 1
        n = 5 if self._looks > 3 else 0
        t_ns = time.monotonic_ns() - np.arange(n, dtype=np.int64)[::-1] * 1_000_000
        return BenchScans(t_ns, np.full((n, self._actuators), 0.1), np.full((n, self._actuators), 1e4), 0)

    def write(self, outputs: np.ndarray) -> None:  # type: ignore[type-arg]
        raise AssertionError("a warm-up moves no valve")


def test_control_warms_up_with_a_cycle_though_the_first_scans_are_late(
    plan: RunPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps = []

    def counted(*arguments: object) -> object:
        steps.append(arguments)
        return step(*arguments)  # type: ignore[arg-type]

    step = control.step
    monkeypatch.setattr(control, "step", counted)
    control_process._warm_up(ChildJob(plan, -1, os.getpid()), SlowBench(plan.config.actuators))  # type: ignore[arg-type]
    assert len(steps) > 1


def test_the_calendar_time_is_anchored_at_the_first_cycle_not_at_the_start_of_the_journal() -> None:
    before_ns = time.time_ns()
    about = experiment.header(prepare("ramp-a", "mock"), t_ns=5, ahead_ns=10**12)
    assert about.started_t_ns == 5
    assert before_ns <= about.started_utc_ns - 10**12 <= time.time_ns()


def test_the_death_of_one_process_ends_the_start_while_another_still_loads(parent: supervisor.Supervisor) -> None:
    loading = child(parent.processes, "watchdog", SLEEPS)
    child(parent.processes, "observer", "import sys; sys.exit(3)")
    with pytest.raises(StartError, match=r"the observer process died while it started \(exit status 3\)"):
        parent.await_ready("watchdog")
    loading.kill()
    assert parent.end() == ""


def test_the_last_message_of_a_process_is_reported_rather_than_its_exit(parent: supervisor.Supervisor) -> None:
    child(parent.processes, "watchdog", "").wait()
    parent.memory.publish_stage("watchdog", Stage.FAILED, "the card is not there")
    with pytest.raises(StartError, match="the card is not there"):
        parent.await_ready("watchdog")
    assert parent.end() == ""


def test_a_run_whose_control_ended_before_its_start_is_not_called_armed(parent: supervisor.Supervisor) -> None:
    parent.memory.request_stop(Stop.TERMINATED)
    parent.memory.publish_stage("control", Stage.DONE)
    with pytest.raises(StartError, match="before the run began, the control process received SIGTERM"):
        parent.await_ready("control")


def test_a_process_that_was_not_started_is_not_waited_for(group: ProcessGroup, memory: SharedState) -> None:
    loading = [child(group, name, "import time; time.sleep(5)") for name in ("watchdog", "control")]
    memory.simulator_starting = 1
    assert group.end(60.0) == set()
    assert [process.returncode for process in loading] == [-signal.SIGKILL] * 2


def test_valves_that_no_process_can_make_safe_are_reported_though_the_run_did_not_start(
    parent: supervisor.Supervisor, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("watchdog", "control"):
        child(parent.processes, name, "").wait()
    parent.memory.heartbeat("control", 1)
    monkeypatch.setattr("rig.realtime.failsafe.force_safe_state", lambda *_: "no answer")
    assert parent.end() == "the safe state could not be written, shut the air off by hand: no answer"


@pytest.mark.parametrize(
    ("program", "said"),
    [("import sys; sys.exit(7)", "exit status 7"), ("print('hello', flush=True); input()", "its output is b'hello")],
)
def test_a_simulator_that_does_not_start_is_reported(plan: RunPlan, program: str, said: str, tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    simulation = PlantProcess(process, plan.config)

    def wait() -> None:
        limit = time.monotonic() + 30
        while time.monotonic() < limit and not simulation.ready():
            time.sleep(0.01)

    with pytest.raises(CardError, match=said):
        wait()
    simulation.close()
    assert process.stdin is not None
    process.stdin.close()


def test_a_job_larger_than_a_pipe_is_handed_over_before_the_child_reads_it(
    plan: RunPlan, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    loading = tmp_path / "loading"
    loading.write_text("#!/bin/sh\nexec sleep 20\n")
    loading.chmod(0o700)
    monkeypatch.setattr(child_process.sys, "executable", str(loading))
    long = replace(plan, trajectory=replace(plan.trajectory, source="x" * 1_000_000))
    memory = SharedState.create(plan.config)
    process = child_process.spawn("rig.realtime.control_process", ChildJob(long, memory.fd, os.getpid()))
    assert process.poll() is None
    with Path(f"/proc/{process.pid}/fd/0").open("rb") as told:
        assert pickle.load(told).plan.trajectory.source == long.trajectory.source
    process.kill()
    process.wait()
    os.close(memory.fd)


@pytest.mark.parametrize("name", ["watchdog", "control", "observer"])
def test_a_process_stopped_before_its_start_takes_its_job_and_exits(plan: RunPlan, name: str) -> None:
    memory = SharedState.create(plan.config)
    memory.simulator_starting = 1
    memory.request_stop(Stop.SAFE)
    process = child_process.spawn(f"rig.realtime.{name}_process", ChildJob(plan, memory.fd, os.getpid()))
    # The observer waits until the bench is safe.
    memory.publish_stage("control" if name == "observer" else "observer", Stage.DONE)
    assert process.wait(60) == 0
    assert memory.stage(name) is Stage.DONE
    assert not memory.heartbeat_ns(name)
    os.close(memory.fd)


def test_control_that_stalls_before_its_first_cycle_ends_the_run(
    group: ProcessGroup, memory: SharedState, monkeypatch: pytest.MonkeyPatch
) -> None:
    timing, now = TimingLimits(TimingProfile.STRICT, control_hung_ns=30_000_000), 10**9
    monkeypatch.setattr(process_group.time, "monotonic_ns", lambda: now)
    for name in ("control", "watchdog"):
        memory.publish_stage(name, Stage.READY)
    memory.heartbeat("control", now)
    faults = []
    for _ in range(50):
        now += 20_000_000
        for name in ("observer", "watchdog"):
            memory.heartbeat(name, now)
        faults.append(group.fault(timing))
    assert faults[0] is None
    assert faults[-1] is not None
    assert faults[-1].source == "control"


def test_control_sockets_of_killed_runs_are_removed_and_others_kept(
    plan: RunPlan, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(runtime_folder, "BASE", tmp_path)
    memory = SharedState.create(plan.config)
    with (
        socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as left,
        socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as going,
    ):
        left.bind(os.fspath(socket_of(1)))
        going.bind(os.fspath(socket_of(2)))
        going.listen()
        left.close()
        door = ControlSocket(plan, memory, StreamReceiver(plan, memory, lambda *_: None))
        assert sorted(socket_paths().iterdir()) == sorted([socket_of(2), door.path])
        door.close()
    os.close(memory.fd)


def test_a_process_stopped_while_it_starts_is_reported(plan: RunPlan, monkeypatch: pytest.MonkeyPatch) -> None:
    class Listener(NullOperator):
        reported = ""

        def report(self, event: Event) -> None:
            self.reported = event.message

    listener = Listener()
    parent = supervisor.Supervisor(plan, listener, None)
    still = child(parent.processes, "observer", SLEEPS)
    still.send_signal(signal.SIGSTOP)
    while not parent.processes.stopped("observer"):
        time.sleep(0.005)
    monkeypatch.setattr(supervisor, "SLOW_START_S", 0.0)
    monkeypatch.setattr(supervisor, "START_TIMEOUT_S", 0.1)
    with pytest.raises(StartError, match="the observer process was not ready"):
        parent.await_ready("observer")
    assert listener.reported == "waiting for the observer process: it was stopped"
    still.kill()
    assert parent.end() == ""
    os.close(parent.memory.fd)
