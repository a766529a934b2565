"""The start of a real-time run: warm-up on scans, calendar anchor at the first cycle, refusals."""

from __future__ import annotations

import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rig.control import regulator
from rig.execution.plan import NullOperator, Outcome, Recorder, RunPlan, StartError
from rig.experiment import run as experiment
from rig.hardware import runtime_folder
from rig.hardware.bench import BenchScans
from rig.hardware.cards.base import CardError
from rig.hardware.vent_verification import UNCONFIRMED, VentOutcome
from rig.realtime import child_process, control_process, process_group, shutdown, supervisor
from rig.realtime.child_process import ChildJob
from rig.realtime.control_socket import ControlSocket, socket_of, socket_paths
from rig.realtime.data_recorder import DataRecorder
from rig.realtime.process_group import ProcessFault, ProcessGroup
from rig.realtime.scheduling import Scheduling
from rig.realtime.shared_state import SharedState, Stage, StateLayout, Stop
from rig.realtime.stream_receiver import StreamReceiver
from rig.realtime.timing_limits import TimingLimits, TimingProfile
from rig.simulator.plant_launcher import Simulation
from rig.simulator.registers import Registers
from runs.journal.append_only_file import JournalError
from runs.records import Event, Level, Picture, Status
from tests.support.mock_registers import mock_registers


@pytest.fixture(scope="module")
def request_() -> experiment.RunRequest:
    return experiment.request("ramp-a", "mock")


@pytest.fixture(scope="module")
def plan(request_: experiment.RunRequest) -> RunPlan:
    return experiment.plan(request_)


HOLD_STILL = (
    "import ctypes, sys, time\nptrace = ctypes.CDLL(None).ptrace\nptrace.argtypes = [ctypes.c_long] * 4\n"
    "print('held' if ptrace(16, int(sys.argv[1]), 0, 0) == 0 else 'refused', flush=True)\ntime.sleep(60)\n"
)
"""Attaches with PTRACE_ATTACH and never waits for the traced process."""


class Unwritten:
    """A recorder that discards everything."""

    stalled_s = 0.0

    def samples(self, rows: np.ndarray) -> None:  # type: ignore[type-arg]
        """Discard it."""

    def observations(self, rows: np.ndarray) -> None:  # type: ignore[type-arg]
        """Discard it."""

    def adaptations(self, rows: np.ndarray) -> None:  # type: ignore[type-arg]
        """Discard it."""

    def picture(self, picture: Picture) -> None:
        """Discard it."""

    def event(self, event: Event) -> None:
        """Discard it."""


class FullDisk(Unwritten):
    """A recorder whose disk is full."""

    def event(self, event: Event) -> None:
        """Refuse it."""
        raise JournalError("the disk is full")


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

    def write(self, valve_v: np.ndarray) -> None:  # type: ignore[type-arg]
        raise AssertionError("a warm-up moves no valve")


def test_control_warms_up_with_a_cycle_though_the_first_scans_are_late(
    plan: RunPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps = []

    def counted(*arguments: object) -> object:
        steps.append(arguments)
        return step(*arguments)  # type: ignore[arg-type]

    step = regulator.step
    monkeypatch.setattr(regulator, "step", counted)
    control_process._warm_up(ChildJob(plan, -1, os.getpid()), SlowBench(plan.config.actuators))  # type: ignore[arg-type]
    assert len(steps) > len(plan.config.valves)


def test_the_calendar_time_is_anchored_at_the_first_cycle_not_at_the_start_of_the_journal(
    request_: experiment.RunRequest, plan: RunPlan
) -> None:
    before_ns = time.time_ns()
    about = experiment.header(request_, plan, t_ns=5, ahead_ns=10**12)
    assert about.started_t_ns == 5
    assert before_ns <= about.started_utc_ns - 10**12 <= time.time_ns()


@pytest.fixture
def memory(plan: RunPlan) -> Iterator[SharedState]:
    memory = SharedState.create(StateLayout.of(plan.config))
    yield memory
    os.close(memory.fd)


@pytest.fixture
def group(plan: RunPlan, memory: SharedState) -> ProcessGroup:
    """The processes of a run of that plan; none is started."""
    return ProcessGroup(plan, memory, None, supervisor.PERIOD_S)


@pytest.fixture
def parent(plan: RunPlan) -> Iterator[supervisor.Supervisor]:
    parent = supervisor.Supervisor(plan, NullOperator(), None)
    yield parent
    os.close(parent.memory.fd)


@pytest.fixture
def own_parent(own_plan: RunPlan) -> Iterator[supervisor.Supervisor]:
    """A supervisor of a run on the card of `registers`."""
    parent = supervisor.Supervisor(own_plan, NullOperator(), None)
    yield parent
    os.close(parent.memory.fd)


SLEEPS = "import time; time.sleep(60)"


def child(group: ProcessGroup, name: str, program: str) -> subprocess.Popen[bytes]:
    """Add a process that runs a Python program to a group."""
    process = subprocess.Popen([sys.executable, "-c", program])
    group.add(name, process)
    return process


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
    monkeypatch.setattr(shutdown, "force_safe_state", lambda *_: "no answer")
    assert parent.end() == "the safe state could not be written, shut the air off by hand: no answer"


@pytest.mark.parametrize(
    ("program", "said"),
    [("import sys; sys.exit(7)", "exit status 7"), ("print('hello', flush=True); input()", "its output is b'hello")],
)
def test_a_simulator_that_does_not_start_is_reported(plan: RunPlan, program: str, said: str, tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    simulation = Simulation(process, plan.config)

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
    memory = SharedState.create(StateLayout.of(plan.config))
    process = child_process.spawn("rig.realtime.control_process", ChildJob(long, memory.fd, os.getpid()))
    assert process.poll() is None
    with Path(f"/proc/{process.pid}/fd/0").open("rb") as told:
        assert pickle.load(told).plan.trajectory.source == long.trajectory.source
    process.kill()
    process.wait()
    os.close(memory.fd)


@pytest.mark.parametrize("name", ["watchdog", "control", "observer"])
def test_a_process_stopped_before_its_start_takes_its_job_and_exits(plan: RunPlan, name: str) -> None:
    memory = SharedState.create(StateLayout.of(plan.config))
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


@pytest.fixture
def registers() -> Iterator[Registers]:
    """A mock card with open valves and without a plant."""
    with mock_registers(f"started-{os.getpid()}", 7.0) as registers:
        yield registers


@pytest.fixture
def own_plan(plan: RunPlan, registers: Registers) -> RunPlan:
    """A plan for that card."""
    cards = {
        name: card.model_copy(update={"device": f"started-{os.getpid()}"}) for name, card in plan.config.cards.items()
    }
    return replace(plan, config=plan.config.model_copy(update={"cards": cards}))


def test_an_error_in_control_is_reported_by_name_and_the_valves_are_safe(
    own_plan: RunPlan, registers: Registers, monkeypatch: pytest.MonkeyPatch
) -> None:
    memory = SharedState.create(StateLayout.of(own_plan.config))
    memory.publish_stage("watchdog", Stage.READY)

    def fails(*_: object) -> None:
        registers.outputs["volts"] = 7.0
        raise ZeroDivisionError("of a warm-up")

    monkeypatch.setattr(control_process, "receive_job", lambda: (ChildJob(own_plan, memory.fd, os.getppid()), memory))
    monkeypatch.setattr(control_process, "_warm_up", fails)
    monkeypatch.setattr(control_process, "enable_realtime_scheduling", lambda priority: Scheduling.NONE)
    monkeypatch.setattr(control_process, "_verify_venting", lambda *_: VentOutcome(True, ""))
    before = signal.getsignal(signal.SIGTERM)
    try:
        with pytest.raises(ZeroDivisionError):
            control_process.main()
    finally:
        signal.signal(signal.SIGTERM, before)
    assert registers.outputs["volts"].tolist() == [0.0, 0.0]
    assert memory.safe_ns
    assert memory.stage("control") is Stage.FAILED
    assert memory.message("control") == "the control process failed: ZeroDivisionError: of a warm-up"
    os.close(memory.fd)


def test_outputs_that_do_not_read_back_safe_at_the_end_are_not_called_safe(
    own_parent: supervisor.Supervisor, registers: Registers
) -> None:
    own_parent.memory.safe_ns = 1
    assert own_parent.shutdown.verify(own_parent.timing) == ""
    assert "valve 1 stands at 7.000 V" in own_parent.shutdown.written_message
    assert registers.outputs["volts"].tolist() == [0.0, 0.0]
    registers.outputs["volts"] = 7.0
    registers.faults.inject(failing_writes=10**9)
    said = own_parent.shutdown.verify(own_parent.timing)
    assert "shut the air off by hand" in said
    assert "valve 1 stands at 7.000 V" in said


def test_control_sockets_of_killed_runs_are_removed_and_others_kept(
    plan: RunPlan, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(runtime_folder, "BASE", tmp_path)
    memory = SharedState.create(StateLayout.of(plan.config))
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


def test_the_reason_for_the_end_is_reported_even_if_the_watchdog_has_to_be_killed(
    plan: RunPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stalled process has not exited when the run ends."""
    ended = Outcome(Status.ABORTED, "the watchdog process has been silent for 1.2 s", 5, {"missed_deadlines": 3})

    def supervised(parent: supervisor.Supervisor, _: object) -> Outcome:
        parent.timing = replace(parent.timing, ending_s=0.1)
        child(parent.processes, "watchdog", SLEEPS)
        return ended

    monkeypatch.setattr(supervisor, "started", lambda *_: nullcontext())
    monkeypatch.setattr(supervisor.Supervisor, "run", supervised)
    outcome = supervisor.run(plan, lambda _: None, NullOperator())  # type: ignore[arg-type, return-value]
    assert outcome.message.startswith(f"{ended.message}; the watchdog did not end")
    assert outcome.status is Status.ABORTED
    assert outcome.counters == ended.counters


def recorded(parent: supervisor.Supervisor, plan: RunPlan, journal: Recorder | None = None) -> None:
    """Let a supervisor record into a journal; without one its records are discarded."""
    parent.record = DataRecorder(plan.config, parent.memory, journal or Unwritten(), NullOperator())


def test_a_run_stopped_while_its_supervisor_stalled_is_not_called_finished(
    parent: supervisor.Supervisor, plan: RunPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The supervisor stalls right after it checked for a stop request, and wakes after the end."""
    recorded(parent, plan)

    def stalled(_: TimingLimits) -> None:
        parent.memory.request_stop(Stop.SILENT)
        parent.memory.publish_stage("control", Stage.DONE)

    monkeypatch.setattr(parent.processes, "fault", stalled)
    assert parent.supervise() == (Status.ABORTED, supervisor.STOP_MESSAGES[Stop.SILENT])


def test_a_full_disk_hides_no_fault_of_a_process(
    parent: supervisor.Supervisor, plan: RunPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded(parent, plan, FullDisk())
    child(parent.processes, "observer", "").wait()
    monkeypatch.setattr(parent.shutdown, "make_safe", lambda _: None)
    assert parent.supervise() == (Status.ABORTED, "the observer process died (exit status 0)")


def test_a_full_disk_ends_a_run_whose_processes_are_well(
    parent: supervisor.Supervisor, plan: RunPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded(parent, plan, FullDisk())
    parent.record.event(Level.INFO, "control", "armed")
    monkeypatch.setattr(parent.processes, "fault", lambda _: None)
    assert parent.supervise() == (Status.ABORTED, "the record could not be written: the disk is full")


OPERATOR = (Status.INTERRUPTED, "by the operator (Ctrl-C)")


@pytest.mark.parametrize(
    ("ending", "control", "watchdog", "journal", "told"),
    [
        ((Status.ABORTED, "the camera is gone"), UNCONFIRMED, "", Unwritten, f"the camera is gone; {UNCONFIRMED}"),
        (OPERATOR, "", "the control process hung", Unwritten, f"{OPERATOR[1]}; the control process hung"),
        (OPERATOR, "", "", FullDisk, f"{OPERATOR[1]}; the record could not be written: the disk is full"),
    ],
    ids=["air remains", "control hangs while it ends", "disk is full at the end"],
)
def test_the_first_reason_for_the_end_is_reported_with_the_faults_that_follow(
    own_parent: supervisor.Supervisor,
    monkeypatch: pytest.MonkeyPatch,
    ending: tuple[Status, str],
    control: str,
    watchdog: str,
    journal: type[Unwritten],
    told: str,
) -> None:
    monkeypatch.setattr(own_parent, "await_ready", lambda name: None)
    monkeypatch.setattr(process_group, "spawn", lambda *_: subprocess.Popen([sys.executable, "-c", ""]))
    monkeypatch.setattr(own_parent.shutdown, "verify", lambda _: "")
    monkeypatch.setattr(own_parent.shutdown, "confirm", lambda _: VentOutcome(True, ""))

    def supervise() -> tuple[Status, str]:
        own_parent.memory.safe_ns = 1
        own_parent.memory.publish_stage("control", Stage.FAILED if control else Stage.DONE, control)
        if watchdog:
            own_parent.memory.publish_stage("watchdog", Stage.DONE, watchdog)
            own_parent.memory.watchdog_trip_ns = 1
        return ending

    monkeypatch.setattr(own_parent, "supervise", supervise)
    outcome = own_parent.run(lambda t_ns: journal())
    assert outcome.status is Status.ABORTED
    assert outcome.message == told
    own_parent.end()


def test_a_process_held_by_a_debugger_does_not_delay_the_end_of_the_run(group: ProcessGroup) -> None:
    """The kernel hides the exit of a traced process from its parent until the debugger waits for it."""
    held = child(group, "observer", SLEEPS)
    with subprocess.Popen([sys.executable, "-c", HOLD_STILL, str(held.pid)], stdout=subprocess.PIPE) as debugger:
        assert debugger.stdout is not None
        if debugger.stdout.readline() != b"held\n":
            pytest.skip("this machine lets no process trace another")
        ending = threading.Thread(target=group.end, args=(0.1,), daemon=True)
        ending.start()
        ending.join(20)
        hung = ending.is_alive()
        debugger.kill()
    ending.join(20)
    assert not hung
    held.wait(20)


@pytest.mark.parametrize(("died", "said"), [(True, " (exit status -9)"), (False, "")])
def test_the_exit_status_of_a_process_killed_for_silence_is_not_reported(
    parent: supervisor.Supervisor, died: bool, said: str
) -> None:
    child(parent.processes, "control", SLEEPS).kill()
    fault = parent.processes.completed(ProcessFault("control", "a fault"), parent.timing, died=died)
    assert fault == ("control", f"a fault{said}")
    assert parent.end() == ""


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


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (JournalError("the disk is full"), f"the disk is full; {UNCONFIRMED}"),
        (StartError(UNCONFIRMED), UNCONFIRMED),
    ],
)
def test_remaining_air_is_reported_whatever_ends_a_run(
    plan: RunPlan, monkeypatch: pytest.MonkeyPatch, error: Exception, told: str
) -> None:
    def supervised(parent: supervisor.Supervisor, _: object) -> Outcome:
        parent.memory.publish_stage("control", Stage.FAILED, UNCONFIRMED)
        raise error

    monkeypatch.setattr(supervisor, "started", lambda *_: nullcontext())
    monkeypatch.setattr(supervisor.Supervisor, "run", supervised)
    with pytest.raises((CardError, StartError)) as raised:
        supervisor.run(plan, lambda _: None, NullOperator())  # type: ignore[arg-type, return-value]
    assert str(raised.value) == told
