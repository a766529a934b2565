"""A run in real time ends safe, with a readable archive and a plain message, however it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

import runs
from rig.simulator.faults import CameraFault, ValveFault
from rig.simulator.registers import path_of
from runs.records import Status
from runs.recovery import recover
from scripts.rig_process import BRIEF, SHORT, RigProcess, rig_run

pytestmark = pytest.mark.realtime

CONTROL, OBSERVER, WATCHDOG = (
    "rig.realtime.control_process",
    "rig.realtime.observer_process",
    "rig.realtime.watchdog_process",
)
SIMULATOR = "rig.simulator.plant_process"


def vent(run: RigProcess) -> None:
    """Run `rig vent` as from another shell, and assert that it succeeds."""
    command = [sys.executable, "-m", "rig", "vent", "--rig", str(run.rig_file)]
    subprocess.run(command, check=True, capture_output=True)


def recover_one(run: RigProcess) -> None:
    """Recover the archive of a killed run, and assert that it holds the recorded data."""
    (outcome,) = recover(run.out)
    assert outcome.archive is not None
    archive = runs.open(outcome.archive)
    assert archive.status is Status.RECOVERED
    assert len(archive.pressure.time_s) > 25


def test_a_run_to_the_end_leaves_safe_valves_a_finished_archive_and_status_0(tmp_path: Path) -> None:
    with rig_run(tmp_path, BRIEF) as run:
        assert run.end() == 0, run.output
        assert run.valves_are_safe()
    archive = runs.open(run.archive())
    assert archive.status is Status.FINISHED
    assert archive.pressure.protocol_s[-1] == pytest.approx(1.0)
    # No sooner than its protocol is long; where the machine stalls at its end, later.
    assert archive.pressure.time_s[-1] > 0.95
    assert np.all(np.diff(archive.pressure.cycle) >= 1)
    assert len(archive.tip.time_s) > 15
    # The next cycle after the last one, in which the safe state is written, is the end.
    assert archive.tip.time_s[-1] <= archive.pressure.time_s[-1] + 0.02
    assert "SIMULATED" in run.output


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_makes_the_valves_safe_finalises_the_archive_and_gives_status_130(
    tmp_path: Path, number: signal.Signals
) -> None:
    with rig_run(tmp_path) as run:
        run.wait_until_pressurised()
        run.process.send_signal(number)
        run.wait_until_safe()
        assert run.end() == 130, run.output
    archive = runs.open(run.archive())
    assert archive.status is Status.INTERRUPTED
    assert len(archive.pressure.time_s) > 25
    assert number.name in run.output or "Ctrl-C" in run.output


def test_a_signal_before_the_run_begins_leaves_safe_valves_and_status_130(tmp_path: Path) -> None:
    with rig_run(tmp_path) as run:
        run.wait_until_started()
        run.process.send_signal(signal.SIGINT)
        assert run.end() == 130, run.output
        assert run.valves_are_safe()
        assert not list(run.out.glob("*.h5"))
        assert "Traceback" not in run.output


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
@pytest.mark.parametrize("module", [CONTROL, WATCHDOG, OBSERVER])
def test_a_lost_or_hung_process_aborts_the_run_with_the_valves_safe(
    tmp_path: Path, module: str, number: signal.Signals
) -> None:
    with rig_run(tmp_path) as run:
        run.wait_until_pressurised()
        os.kill(run.pid_of(module), number)
        run.wait_until_safe()
        assert run.end() == 1, run.output
        assert run.valves_are_safe()
    archive = runs.open(run.archive())
    assert archive.status is Status.ABORTED
    name = {CONTROL: "control", WATCHDOG: "watchdog", OBSERVER: "observer"}[module]
    assert name in archive.message
    assert archive.message in run.output


def test_a_dead_simulator_counts_as_a_dead_card(tmp_path: Path) -> None:
    with rig_run(tmp_path) as run:
        run.wait_until_pressurised()
        os.kill(run.pid_of(SIMULATOR), signal.SIGKILL)
        run.wait_until_safe()
        assert run.end() == 1, run.output
    assert runs.open(run.archive()).status is Status.ABORTED


@pytest.mark.parametrize("others", [(CONTROL, OBSERVER), (WATCHDOG,)], ids=["watchdog left", "control left"])
def test_any_survivor_of_the_supervisor_makes_the_valves_safe_and_the_journal_is_recoverable(
    tmp_path: Path, others: tuple[str, ...]
) -> None:
    with rig_run(tmp_path) as run:
        run.wait_until_pressurised()
        victims = [run.pid_of(module) for module in others]
        for pid in (run.process.pid, *victims):
            os.kill(pid, signal.SIGKILL)
        run.wait_until_safe()
    recover_one(run)


@pytest.mark.parametrize("how", ["camera lost, too", "only a stop request"])
def test_the_last_remaining_process_makes_the_valves_safe(tmp_path: Path, how: str) -> None:
    with rig_run(tmp_path) as run:
        run.wait_until_pressurised()
        victims = [run.pid_of(module) for module in (CONTROL, WATCHDOG)]
        if how == "only a stop request":
            os.kill(run.process.pid, signal.SIGINT)
        else:
            run.card.faults.inject(camera=CameraFault.UNPLUGGED)
        for pid in (*victims, run.process.pid):
            os.kill(pid, signal.SIGKILL)
        run.wait_until_safe()
    recover_one(run)


def test_a_hung_supervisor_makes_the_valves_safe_and_the_run_aborted_once_it_wakes(tmp_path: Path) -> None:
    with rig_run(tmp_path) as run:
        run.wait_until_pressurised()
        run.process.send_signal(signal.SIGSTOP)
        run.wait_until_safe()
        run.process.send_signal(signal.SIGCONT)
        assert run.end() == 1, run.output
    assert runs.open(run.archive()).status is Status.ABORTED


def test_a_killed_supervisor_leaves_safe_valves_no_process_and_a_journal_that_can_be_recovered(tmp_path: Path) -> None:
    with rig_run(tmp_path) as run:
        run.wait_until_pressurised()
        pids = [run.pid_of(module) for module in (CONTROL, OBSERVER, WATCHDOG, SIMULATOR)]
        run.process.kill()
        run.wait_until_safe()
        deadline = time.monotonic() + 15
        while any(Path(f"/proc/{pid}").exists() for pid in pids):
            assert time.monotonic() < deadline, [pid for pid in pids if Path(f"/proc/{pid}").exists()]
            time.sleep(0.05)
    recover_one(run)


def test_runs_of_one_simulated_rig_go_on_beside_each_other_and_rig_vent_ends_both(tmp_path: Path) -> None:
    (tmp_path / "second").mkdir()
    with rig_run(tmp_path) as run, rig_run(tmp_path / "second", SHORT, "--rig", str(run.rig_file)) as second:
        second.config = run.config
        run.wait_until_pressurised()
        second.wait_until_pressurised()
        assert not run.valves_are_safe()
        vent(run)
        for one in (run, second):
            one.wait_until_safe(1.0)
            assert one.end() == 130, one.output
            archive = runs.open(one.archive())
            assert archive.status is Status.INTERRUPTED
            assert archive.message == "vented by `rig vent`"
            assert not [device for device in one.devices if path_of(device).exists()]


def test_rig_vent_makes_the_valves_safe_while_a_run_hangs(tmp_path: Path) -> None:
    with rig_run(tmp_path) as run:
        run.wait_until_pressurised()
        pids = [run.process.pid, run.pid_of(WATCHDOG), run.pid_of(CONTROL)]
        for pid in pids:
            os.kill(pid, signal.SIGSTOP)
        vent(run)
        run.wait_until_safe(1.0)
        for pid in pids:
            # The first one that goes on may end the others.
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)


def test_rig_vent_stops_a_run_that_is_starting(tmp_path: Path) -> None:
    with rig_run(tmp_path) as run:
        run.wait_until_started()
        os.kill(run.pid_of(OBSERVER), signal.SIGSTOP)  # it is waited for
        vent(run)
        assert run.end() == 130, run.output
        assert run.valves_are_safe()
        assert "before the run began" in run.output


def test_an_over_pressure_stops_the_run(tmp_path: Path) -> None:
    with rig_run(tmp_path, SHORT) as run:
        run.wait_until_pressurised()
        # The valve of actuator 1 sticks as far open as it goes, whatever the command is.
        run.card.faults.inject(valve_1=ValveFault.STUCK, valve_value_1=10.0)
        assert run.end() == 1, run.output
        run.wait_until_safe()
    assert "bar" in runs.open(run.archive()).message


@pytest.mark.parametrize("modules", [(CONTROL,), (WATCHDOG,), (SIMULATOR,), (CONTROL, SIMULATOR)], ids=str)
def test_a_delayed_process_does_not_stop_a_run_on_a_simulated_bench(tmp_path: Path, modules: tuple[str, ...]) -> None:
    """Processes are delayed as by a busy machine or its host while valves are driven."""
    with rig_run(tmp_path, BRIEF, supervised=False) as run:
        run.wait_until_pressurised()
        pids = [run.pid_of(module) for module in modules]
        for pid in pids:
            os.kill(pid, signal.SIGSTOP)
        time.sleep(1.5)
        for pid in pids:
            os.kill(pid, signal.SIGCONT)
        assert run.end() == 0, run.output
    archive = runs.open(run.archive())
    assert archive.status is Status.FINISHED
    assert any("simulated bench" in event.message for event in archive.events)
    assert "simulated bench" in run.output


def test_a_stopped_observer_ends_a_run_on_a_simulated_bench(tmp_path: Path) -> None:
    with rig_run(tmp_path, supervised=False) as run:
        run.wait_until_pressurised()
        os.kill(run.pid_of(OBSERVER), signal.SIGSTOP)
        run.wait_until_safe(20.0)
        assert run.end() == 1, run.output
    assert "the observer process has been stopped for 5.0 s, by a signal" in runs.open(run.archive()).message


def test_a_simulator_that_stalls_for_good_ends_the_run(tmp_path: Path) -> None:
    with rig_run(tmp_path, supervised=False) as run:
        run.wait_until_pressurised()
        os.kill(run.pid_of(SIMULATOR), signal.SIGSTOP)
        run.wait_until_safe(40.0)
        assert run.end() == 1, run.output
    assert "the simulator has stalled" in runs.open(run.archive()).message
