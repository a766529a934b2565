"""The failsafe makes the bench safe: at once if the other processes are dead, after a limit if they are stalled."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import pytest

import rig.config.loader
from protocols import SetPointTrajectory
from rig.config.schema import RigConfig
from rig.execution.plan import RunPlan
from rig.hardware import call_limit
from rig.hardware.safe_state import UNSAFE, RigSafeState
from rig.realtime import watchdog_process
from rig.realtime.child_process import ChildJob, await_device_access, ended_within, supervisor_monitor
from rig.realtime.failsafe import FailsafeThread, force_safe_state
from rig.realtime.process_monitor import ProcessMonitor
from rig.realtime.scheduling import Scheduling
from rig.realtime.shared_state import SharedState, Stage, Stop
from rig.realtime.timing_limits import TimingLimits, TimingProfile
from rig.simulator import plant_launcher
from rig.simulator.registers import Registers, path_of
from scripts.rig_process import strict
from tests.support.mock_registers import mock_registers
from tests.support.waiting import wait_until

OPEN_V, SAFE_V = 7.0, 0.0
LENIENT = TimingLimits(TimingProfile.STRICT, control_hung_ns=10**10)
HOLD_STILL = (
    "import ctypes, sys, time\nptrace = ctypes.CDLL(None).ptrace\nptrace.argtypes = [ctypes.c_long] * 4\n"
    "print('held' if ptrace(16, int(sys.argv[1]), 0, 0) == 0 else 'refused', flush=True)\ntime.sleep(60)\n"
)
"""Attaches with PTRACE_ATTACH and never waits for the traced process."""


@pytest.fixture
def registers() -> Iterator[Registers]:
    """A mock card with open valves and without a plant."""
    with mock_registers(f"guarded-{os.getpid()}", OPEN_V) as registers:
        yield registers


@pytest.fixture
def config(registers: Registers) -> RigConfig:
    text = strict(rig.config.loader.text("mock")).replace("device: mock0", f"device: guarded-{os.getpid()}")
    return rig.config.loader.parse(text, "rig.yaml")


@pytest.fixture
def memory(config: RigConfig) -> Iterator[SharedState]:
    memory = SharedState.create(config)
    memory.heartbeat("supervisor", time.monotonic_ns())
    yield memory
    os.close(memory.fd)


@pytest.fixture
def sleeper() -> Iterator[subprocess.Popen[bytes]]:
    """A process that sleeps; it is killed after the test."""
    with subprocess.Popen(["sleep", "60"], stdout=subprocess.PIPE) as process:
        yield process
        process.kill()


def dead() -> int:
    """The id of a process that has exited."""
    process = subprocess.Popen(["true"])
    process.wait()
    return process.pid


def job(config: RigConfig, memory: SharedState, supervisor: int) -> ChildJob:
    nothing = SetPointTrajectory(0.0, config.actuators, (), (), "")
    return ChildJob(RunPlan(config, path_of("none"), nothing, config.model.variant, 0), memory.fd, supervisor)


def volts(registers: Registers) -> list[float]:
    stand: list[float] = registers.outputs["value"].tolist()
    return stand


def test_a_process_counts_as_exited_before_its_status_is_collected(
    sleeper: subprocess.Popen[bytes],
) -> None:
    monitor = ProcessMonitor(sleeper.pid)
    assert not monitor.exited
    assert not monitor.stopped
    sleeper.send_signal(signal.SIGSTOP)
    wait_until(lambda: monitor.stopped)
    assert not monitor.exited
    sleeper.kill()
    wait_until(lambda: monitor.exited)
    assert ended_within(sleeper, 30)
    assert monitor.exited
    assert not monitor.stopped
    monitor.close()


def test_a_process_held_by_a_debugger_counts_as_stalled_and_its_kill_does_not_block(
    sleeper: subprocess.Popen[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernel hides the exit of a traced process from its parent until the debugger waits for it."""
    monkeypatch.setattr(plant_launcher, "EXIT_S", 0.2)
    monitor = ProcessMonitor(sleeper.pid)
    with subprocess.Popen([sys.executable, "-c", HOLD_STILL, str(sleeper.pid)], stdout=subprocess.PIPE) as debugger:
        assert debugger.stdout is not None
        if debugger.stdout.readline() != b"held\n":
            pytest.skip("this machine lets no process trace another")
        wait_until(lambda: monitor.stopped)
        assert not monitor.exited
        leaving = threading.Thread(
            target=plant_launcher.PlantProcess(sleeper, rig.config.loader.load("mock")).close, daemon=True
        )
        leaving.start()
        leaving.join(20)
        hung = leaving.is_alive()
        assert monitor.exited
        debugger.kill()
    assert not hung
    monitor.close()


def test_a_process_that_never_existed_counts_as_exited() -> None:
    assert ProcessMonitor(dead()).exited


def test_where_all_others_are_dead_the_bench_is_made_safe_at_once(
    config: RigConfig, memory: SharedState, registers: Registers
) -> None:
    memory.control_pid = dead()
    memory.watchdog_pid = dead()
    failsafe = FailsafeThread(job(config, memory, dead()), memory)
    failsafe.join()
    assert volts(registers) == [SAFE_V, SAFE_V]
    assert memory.safe_ns
    assert memory.stop_request == Stop.SILENT


def test_the_last_process_reports_that_the_safe_state_could_not_be_written(
    config: RigConfig, memory: SharedState, registers: Registers, capfd: pytest.CaptureFixture[str]
) -> None:
    registers.faults.inject(failing_writes=10**9)
    memory.control_pid = dead()
    memory.watchdog_pid = dead()
    FailsafeThread(job(config, memory, dead()), memory).join()
    assert UNSAFE in capfd.readouterr().err


def test_the_failsafe_writes_what_the_last_control_process_could_not_write(
    config: RigConfig, memory: SharedState, registers: Registers
) -> None:
    memory.control_pid = dead()
    memory.watchdog_pid = dead()
    memory.publish_stage("control", Stage.FAILED, UNSAFE)
    FailsafeThread(job(config, memory, dead()), memory).join()
    assert volts(registers) == [SAFE_V, SAFE_V]


def test_the_failsafe_leaves_what_control_could_not_write_to_the_supervisor_as_long_as_it_lives(
    config: RigConfig, memory: SharedState, registers: Registers
) -> None:
    memory.control_pid = dead()
    memory.watchdog_pid = dead()
    memory.publish_stage("control", Stage.FAILED, UNSAFE)
    failsafe = FailsafeThread(job(config, memory, os.getppid()), memory)
    time.sleep(0.1)
    assert volts(registers) == [OPEN_V, OPEN_V]
    failsafe._supervisor.close()  # counts as exited
    failsafe.join()
    assert volts(registers) == [SAFE_V, SAFE_V]


def test_the_failsafe_acts_only_once_the_watchdog_is_killed(
    config: RigConfig, memory: SharedState, registers: Registers, sleeper: subprocess.Popen[bytes]
) -> None:
    memory.control_pid = dead()
    memory.watchdog_pid = sleeper.pid
    failsafe = FailsafeThread(job(config, memory, dead()), memory)
    time.sleep(0.2)
    assert volts(registers) == [OPEN_V, OPEN_V]
    sleeper.kill()
    failsafe.join()
    assert volts(registers) == [SAFE_V, SAFE_V]


def test_the_failsafe_replaces_and_ends_processes_that_stall_with_open_valves(
    config: RigConfig, memory: SharedState, registers: Registers, sleeper: subprocess.Popen[bytes]
) -> None:
    memory.control_pid = sleeper.pid
    memory.start_ns = 1
    failsafe = FailsafeThread(job(config, memory, os.getppid()), memory)
    failsafe.join()
    assert volts(registers) == [SAFE_V, SAFE_V]
    assert ended_within(sleeper, 30)


def test_processes_that_stall_before_the_first_cycle_are_left_alone(
    config: RigConfig, memory: SharedState, registers: Registers, sleeper: subprocess.Popen[bytes]
) -> None:
    memory.heartbeat("supervisor", 1)
    memory.control_pid = sleeper.pid
    failsafe = FailsafeThread(job(config, memory, os.getppid()), memory)
    time.sleep(0.9)
    assert volts(registers) == [OPEN_V, OPEN_V]
    assert sleeper.poll() is None
    memory.publish_stage("control", Stage.DONE)
    failsafe.join()


def watchdog_ends(monkeypatch: pytest.MonkeyPatch, job: ChildJob, memory: SharedState) -> int:
    """Run the watchdog process in this process; its exit status."""
    monkeypatch.setattr(watchdog_process, "receive_job", lambda: (job, memory))
    monkeypatch.setattr(watchdog_process, "enable_realtime_scheduling", lambda priority: Scheduling.NONE)
    before = signal.getsignal(signal.SIGTERM)
    try:
        return watchdog_process.main()
    finally:
        signal.signal(signal.SIGTERM, before)


@pytest.mark.parametrize("stage", [Stage.FAILED, Stage.RUNNING], ids=["control could not write", "control was killed"])
def test_without_a_supervisor_the_watchdog_reports_that_the_safe_state_could_not_be_written(
    config: RigConfig,
    memory: SharedState,
    registers: Registers,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    stage: Stage,
) -> None:
    registers.faults.inject(failing_writes=10**9)
    memory.control_pid = dead()
    memory.publish_stage("control", stage, UNSAFE)
    assert watchdog_ends(monkeypatch, job(config, memory, dead()), memory) == 1
    assert UNSAFE in capfd.readouterr().err


@pytest.mark.parametrize(("safe_ns", "left_v"), [(1, OPEN_V), (0, SAFE_V)])
def test_the_watchdog_writes_at_the_end_only_if_control_has_not(
    config: RigConfig,
    memory: SharedState,
    registers: Registers,
    monkeypatch: pytest.MonkeyPatch,
    safe_ns: int,
    left_v: float,
) -> None:
    """Valves that another program vents stay vented, also where control would hold them."""
    memory.control_pid = dead()
    memory.publish_stage("control", Stage.DONE)
    memory.safe_ns = safe_ns
    assert watchdog_ends(monkeypatch, job(config, memory, os.getppid()), memory) == 0
    assert volts(registers) == [left_v, left_v]
    assert memory.stage("watchdog") is Stage.DONE


@pytest.mark.parametrize(("safe_ns", "said"), [(1, ""), (0, "the supervisor died or hung, and control did not stop")])
def test_vent_verification_continues_after_the_supervisor_has_died(
    memory: SharedState, sleeper: subprocess.Popen[bytes], safe_ns: int, said: str
) -> None:
    memory.control_pid = sleeper.pid
    memory.safe_ns = safe_ns
    memory.publish_stage("control", Stage.RUNNING)

    def end() -> None:
        memory.publish_stage("control", Stage.DONE)
        sleeper.kill()

    ending = threading.Timer(0.4, end)
    ending.start()
    assert watchdog_process._watch(memory, dead(), None, lambda: LENIENT) == said  # type: ignore[arg-type]
    ending.join()


def test_a_supervisor_that_hangs_and_dies_costs_control_no_processor_time(
    memory: SharedState, sleeper: subprocess.Popen[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The watchdog exits before control: repeated wake-ups would keep control from exiting."""
    timing = replace(LENIENT, supervisor_silent_ns=20_000_000, grace_ns=400_000_000)
    looks = 0

    def counted(poll: select.poll, timeout_ms: int) -> set[int]:
        nonlocal looks
        looks += 1
        if memory.stop_request:
            supervisor.kill()
        return exited(poll, timeout_ms)

    exited = watchdog_process._exited
    monkeypatch.setattr(watchdog_process, "_exited", counted)
    memory.control_pid = sleeper.pid
    memory.publish_stage("control", Stage.RUNNING)
    with subprocess.Popen(["sleep", "60"]) as supervisor:
        assert "did not stop" in watchdog_process._watch(memory, supervisor.pid, None, lambda: timing)  # type: ignore[arg-type]
    assert looks < 400


def test_a_driver_that_never_returns_from_the_safe_write_is_reported_and_control_is_killed(
    config: RigConfig, memory: SharedState, sleeper: subprocess.Popen[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    released = threading.Event()
    monkeypatch.setattr(RigSafeState, "make_safe", lambda self, *, vent: released.wait())
    monkeypatch.setattr("rig.realtime.failsafe.within", partial(call_limit.within, limit_s=0.05))
    memory.control_pid = sleeper.pid
    assert "has not returned within 0.05 s" in force_safe_state(config, memory)
    released.set()
    assert not memory.safe_ns
    assert ended_within(sleeper, 30)


def test_outputs_that_could_not_be_written_are_not_called_safe(
    config: RigConfig, memory: SharedState, registers: Registers
) -> None:
    registers.faults.inject(failing_writes=10**9)
    assert "could not be written" in force_safe_state(config, memory)
    assert not memory.safe_ns
    assert volts(registers) == [OPEN_V, OPEN_V]


def test_the_first_stop_reason_is_kept_and_vent_overrides_it(memory: SharedState) -> None:
    for asked, told in (
        (Stop.TERMINATED, Stop.TERMINATED),
        (Stop.SAFE, Stop.TERMINATED),
        (Stop.VENT, Stop.VENT),
        (Stop.SILENT, Stop.VENT),
    ):
        memory.request_stop(asked)
        assert memory.stop_request == told


def test_a_request_to_vent_stays_where_another_process_stops_at_the_same_moment(memory: SharedState) -> None:
    memory.request_stop(Stop.VENT)
    # What a process writes that has read the flag before the request.
    memory.stop_request = Stop.TERMINATED
    assert memory.vents


def test_a_process_waits_for_its_start_and_gives_up_once_the_run_is_over(
    config: RigConfig, memory: SharedState
) -> None:
    supervisor = supervisor_monitor(job(config, memory, os.getppid()))
    looks = iter((False, False, True))
    assert await_device_access(memory, supervisor, lambda: next(looks))
    assert not await_device_access(memory, supervisor_monitor(job(config, memory, dead())), lambda: False)
    memory.request_stop(Stop.SAFE)
    assert not await_device_access(memory, supervisor, lambda: False)


def test_control_and_watchdog_of_a_mock_card_do_not_load_numba() -> None:
    program = "import sys, rig.realtime.supervisor, rig.realtime.control_process, rig.realtime.watchdog_process\n"
    program += "import rig.simulator.mock_card\n"
    program += "assert 'numba' not in sys.modules"
    subprocess.run([sys.executable, "-c", program], check=True)
