"""How a real-time run ends: its first reason, a full disk, remaining air, processes that do not exit."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest

from rig.execution.plan import NullOperator, RunPlan, StartError
from rig.hardware.cards.base import CardError
from rig.hardware.safe_state import UNSAFE
from rig.hardware.vent_verification import UNCONFIRMED, VentOutcome
from rig.realtime import control_process, process_group, supervisor
from rig.realtime.child_process import ChildJob
from rig.realtime.data_recorder import DataRecorder
from rig.realtime.outcome import Ending
from rig.realtime.process_group import ProcessFault, ProcessGroup
from rig.realtime.scheduling import Scheduling
from rig.realtime.shared_state import SETPOINTS, SharedState, Stage, Stop
from rig.realtime.timing_limits import TimingLimits
from rig.simulator.registers import Registers
from runs.journal.append_only_file import JournalError
from runs.journal.journal import JournalWriter
from runs.records import Event, Level, Picture, RunFooter, Status, streamed_dtype
from tests.support.child_programs import SLEEPS, child

HOLD_STILL = (
    "import ctypes, sys, time\nptrace = ctypes.CDLL(None).ptrace\nptrace.argtypes = [ctypes.c_long] * 4\n"
    "print('held' if ptrace(16, int(sys.argv[1]), 0, 0) == 0 else 'refused', flush=True)\ntime.sleep(60)\n"
)
"""Attaches with PTRACE_ATTACH and never waits for the traced process."""

OPERATOR = (Status.INTERRUPTED, "by the operator (Ctrl-C)")


class Unwritten:
    """A recorder that discards everything."""

    stalled_s = 0.0
    path = Path("run.mcap")

    def samples(self, rows: np.ndarray) -> None:  # type: ignore[type-arg]
        """Discard it."""

    def observations(self, rows: np.ndarray) -> None:  # type: ignore[type-arg]
        """Discard it."""

    def adaptations(self, rows: np.ndarray) -> None:  # type: ignore[type-arg]
        """Discard it."""

    def plans(self, rows: np.ndarray) -> None:  # type: ignore[type-arg]
        """Discard it."""

    def picture(self, picture: Picture) -> None:
        """Discard it."""

    def streamed(self, rows: np.ndarray) -> None:  # type: ignore[type-arg]
        """Discard it."""

    def event(self, event: Event) -> None:
        """Discard it."""


class FullDisk(Unwritten):
    """A recorder whose disk is full."""

    def event(self, event: Event) -> None:
        """Refuse it."""
        raise JournalError("the disk is full")


def recorded(parent: supervisor.Supervisor, plan: RunPlan, journal: JournalWriter | None = None) -> None:
    """Let a supervisor record into a journal; without one its records are discarded."""
    parent.record = DataRecorder(plan, parent.memory, journal or Unwritten(), NullOperator())


def test_rows_that_were_overwritten_before_they_were_recorded_are_counted(own_plan: RunPlan) -> None:
    memory = SharedState.create(own_plan.config)
    recorder = DataRecorder(own_plan, memory, Unwritten(), NullOperator())
    for _ in range(SETPOINTS + 99):
        memory.streamed.push(np.zeros((), streamed_dtype(own_plan.config.actuators)))
    recorder.drain()
    counters = recorder.counters()
    assert counters["streamed_ring_overflows"] == 100
    assert counters["plan_ring_overflows"] == 0
    os.close(memory.fd)


def test_an_error_in_control_is_reported_by_name_and_the_valves_are_safe(
    own_plan: RunPlan, registers: Registers, monkeypatch: pytest.MonkeyPatch
) -> None:
    memory = SharedState.create(own_plan.config)
    memory.publish_stage("watchdog", Stage.READY)

    def fails(*_: object) -> None:
        registers.outputs["value"] = 7.0
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
    assert registers.outputs["value"].tolist() == [0.0, 0.0]
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
    assert registers.outputs["value"].tolist() == [0.0, 0.0]
    registers.outputs["value"] = 7.0
    registers.faults.inject(failing_writes=10**9)
    said = own_parent.shutdown.verify(own_parent.timing)
    assert "shut the air off by hand" in said
    assert "valve 1 stands at 7.000 V" in said


def test_the_reason_for_the_end_is_reported_even_if_the_watchdog_has_to_be_killed(
    plan: RunPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stalled process has not exited when the run ends."""
    ended = RunFooter(5, Status.ABORTED, "the watchdog process has been silent for 1.2 s", {"missed_deadlines": 3})

    def supervised(parent: supervisor.Supervisor, _: object) -> RunFooter:
        parent.timing = replace(parent.timing, ending_s=0.1)
        child(parent.processes, "watchdog", SLEEPS)
        return ended

    monkeypatch.setattr(supervisor, "started", lambda *_: nullcontext())
    monkeypatch.setattr(supervisor.Supervisor, "run", supervised)
    outcome = supervisor.run(plan, lambda _: None, NullOperator())  # type: ignore[arg-type, return-value]
    assert outcome.message.startswith(f"{ended.message}; the watchdog did not end")
    assert outcome.status is Status.ABORTED
    assert outcome.counters == ended.counters


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
    monkeypatch.setattr(parent.shutdown, "await_safe_state", lambda _: None)
    assert parent.supervise() == (Status.ABORTED, "the observer process died (exit status 0)")


def test_a_full_disk_ends_a_run_whose_processes_are_well(
    parent: supervisor.Supervisor, plan: RunPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded(parent, plan, FullDisk())
    parent.record.event(Level.INFO, "control", "armed")
    monkeypatch.setattr(parent.processes, "fault", lambda _: None)
    assert parent.supervise() == (Status.ABORTED, "the record could not be written: the disk is full")


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

    def supervise() -> Ending:
        own_parent.memory.safe_ns = 1
        own_parent.memory.publish_stage("control", Stage.FAILED if control else Stage.DONE, control)
        if watchdog:
            own_parent.memory.publish_stage("watchdog", Stage.DONE, watchdog)
            own_parent.memory.watchdog_trip_ns = 1
        return Ending(*ending)

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
    fault = parent.processes.completed(ProcessFault("control", "a fault", died), parent.timing)
    assert fault == ("control", f"a fault{said}", died)
    assert parent.end() == ""


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
    def supervised(parent: supervisor.Supervisor, _: object) -> RunFooter:
        parent.memory.publish_stage("control", Stage.FAILED, UNCONFIRMED)
        raise error

    monkeypatch.setattr(supervisor, "started", lambda *_: nullcontext())
    monkeypatch.setattr(supervisor.Supervisor, "run", supervised)
    with pytest.raises((CardError, StartError)) as raised:
        supervisor.run(plan, lambda _: None, NullOperator())  # type: ignore[arg-type, return-value]
    assert str(raised.value) == told


GONE = "box 0 has gone: is the cable in?"


class Events(Unwritten):
    """A recorder that keeps the messages of its events."""

    def __init__(self) -> None:
        self.messages: list[str] = []

    def event(self, event: Event) -> None:
        """Keep it."""
        self.messages.append(event.message)


def unplugged(*_: object) -> NoReturn:
    raise CardError(GONE)


def test_what_an_unplugged_card_says_is_stated_once(
    own_plan: RunPlan, own_parent: supervisor.Supervisor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It fails in the cycle, in the safe state that control writes then, and in the one of the watchdog."""
    memory = own_parent.memory
    monkeypatch.setattr(control_process, "receive_job", lambda: (ChildJob(own_plan, memory.fd, os.getppid()), memory))
    monkeypatch.setattr(control_process, "_warm_up", unplugged)
    monkeypatch.setattr(control_process, "enable_realtime_scheduling", lambda priority: Scheduling.NONE)
    memory.publish_stage("watchdog", Stage.READY)
    before = signal.getsignal(signal.SIGTERM)
    opened = control_process.open_bench

    def opened_then_unplugged(*words: object) -> object:
        bench = opened(*words)  # type: ignore[arg-type]
        bench.safe_state.arm()
        for card in bench._cards.values():
            monkeypatch.setattr(card, "write", unplugged)
        monkeypatch.setattr(bench.safe_state, "arm", lambda: ())
        return bench

    monkeypatch.setattr(control_process, "open_bench", opened_then_unplugged)
    try:
        assert control_process.main() == 1
    finally:
        signal.signal(signal.SIGTERM, before)
    unsafe = f"{UNSAFE}: card daq: {GONE}"
    assert memory.message("control") == unsafe
    memory.publish_stage("watchdog", Stage.FAILED, unsafe)
    monkeypatch.setattr(own_parent.processes, "await_exit", lambda *_: True)
    monkeypatch.setattr("rig.realtime.failsafe.force_safe_state", lambda *_: unsafe)
    events = Events()
    recorded(own_parent, own_plan, events)
    own_parent.record.event(Level.FAULT, "control", unsafe)
    outcome = own_parent._outcome(Ending(Status.ABORTED, unsafe))
    assert (outcome.message, events.messages) == (unsafe, [unsafe])


def test_a_failed_safe_state_that_control_has_reported_is_not_called_unreported(
    own_plan: RunPlan, own_parent: supervisor.Supervisor, monkeypatch: pytest.MonkeyPatch
) -> None:
    unsafe = f"{UNSAFE}: card daq: {GONE}"
    own_parent.memory.publish_stage("control", Stage.FAILED, unsafe)
    monkeypatch.setattr("rig.realtime.failsafe.force_safe_state", lambda *_: "it has gone")
    monkeypatch.setattr(own_parent.processes, "await_exit", lambda *_: True)
    events = Events()
    recorded(own_parent, own_plan, events)
    assert own_parent._outcome(Ending(Status.ABORTED, unsafe)).message == unsafe
    assert events.messages == []
