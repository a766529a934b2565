"""What counts as hung follows from the valves at stake and from the scheduling that was granted."""

from __future__ import annotations

import os
import subprocess
import sys
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

import rig.config.loader
from rig.cli import run_output
from rig.config.schema import RigConfig
from rig.control import step as control
from rig.control.control_loop import ControlLoop
from rig.control.step import Sample
from rig.experiment.options import RunOptions
from rig.experiment.prepare import prepare
from rig.hardware.bench import BenchScans
from rig.realtime.scheduling import REAL_TIME, Scheduling, remedies
from rig.realtime.timing_limits import TimingLimits, TimingProfile, timing_limits, timing_sentence
from rig.simulator.plant import Plant
from scripts.rig_process import BRIEF, strict
from tests.support.plant_bench import mock_rig

MS = 1_000_000


def real_rig(**limits: float) -> RigConfig:
    """The rig of the paper's bench, with a real card."""
    config = rig.config.loader.load("pci1716")
    return config.model_copy(update={"limits": config.limits.model_copy(update=limits)})


def test_real_valves_with_real_time_scheduling_get_the_strict_limits() -> None:
    assert timing_limits(real_rig(), REAL_TIME) == TimingLimits(
        TimingProfile.STRICT,
        control_hung_ns=30 * MS,
        late_check_ns=8 * MS,
        watchdog_silent_ns=1000 * MS,
        supervisor_silent_ns=2000 * MS,
        grace_ns=100 * MS,
        failsafe_silent_ns=200 * MS,
        failsafe_supervisor_ns=500 * MS,
        failsafe_checks=25,
        supervised_control_s=0.5,
        supervised_watchdog_s=1.2,
        frame_s=real_rig().limits.no_tip_s,
        disk_s=10.0,
        vented_s=1.0,
        ending_s=2.0,
        simulator_ns=None,
        simulation_waits_ns=None,
    )


@pytest.mark.parametrize(("rate_hz", "hung_ms"), [(20.0, 150), (100.0, 30), (1000.0, 30)])
@pytest.mark.parametrize("granted", [REAL_TIME, Scheduling.NONE])
def test_a_slow_control_loop_does_not_count_as_hung_between_two_cycles(
    granted: Scheduling, rate_hz: float, hung_ms: int
) -> None:
    slow = real_rig(stale_s=0.02)
    slow = slow.model_copy(update={"control": slow.control.model_copy(update={"rate_hz": rate_hz})})
    assert timing_limits(slow, granted).control_hung_ns == hung_ms * MS


@pytest.mark.parametrize("granted", [Scheduling.NONE, Scheduling.FIFO, Scheduling.LOCKED])
@pytest.mark.parametrize(("stale_s", "hung_ms"), [(0.05, 50), (0.1, 100), (5.0, 100), (0.02, 30)])
def test_real_valves_without_real_time_scheduling_get_stale_s_and_at_most_a_tenth_of_a_second(
    granted: Scheduling, stale_s: float, hung_ms: int
) -> None:
    timing = timing_limits(real_rig(stale_s=stale_s), granted)
    assert timing.profile is TimingProfile.ORDINARY
    assert timing.control_hung_ns == hung_ms * MS
    assert timing.simulation_waits_ns is None


@pytest.mark.parametrize("granted", [Scheduling.NONE, REAL_TIME])
def test_a_simulated_bench_gets_limits_of_seconds_with_any_scheduling(granted: Scheduling) -> None:
    timing = timing_limits(rig.config.loader.load("mock"), granted)
    assert timing.profile is TimingProfile.SIMULATED
    assert timing.control_hung_ns == 5000 * MS


@pytest.mark.parametrize("granted", [Scheduling.NONE, REAL_TIME])
def test_a_stated_hung_s_applies_to_any_bench(granted: Scheduling) -> None:
    mock = rig.config.loader.parse(strict(rig.config.loader.text("mock")), "rig.yaml")
    for config, hung_ms in ((mock, 30), (real_rig(hung_s=0.2), 200)):
        timing = timing_limits(config, granted)
        assert timing == TimingLimits(TimingProfile.STRICT, hung_ms * MS, frame_s=config.limits.no_tip_s)


def test_no_process_counts_as_silent_before_hung_s() -> None:
    strict, patient = (timing_limits(real_rig(hung_s=hung_s), REAL_TIME) for hung_s in (0.2, 5.0))
    assert (strict.watchdog_silent_ns, strict.supervisor_silent_ns) == (1000 * MS, 2000 * MS)
    assert (patient.watchdog_silent_ns, patient.supervisor_silent_ns) == (5000 * MS, 5000 * MS)
    assert (patient.supervised_control_s, patient.supervised_watchdog_s) == (5.0, 5.0)


def test_missing_promises_are_reported_with_the_remedy() -> None:
    said = timing_sentence(real_rig(), Scheduling.NONE)
    assert "100 ms" in said
    assert "no reaction time can be promised" in said
    assert "rtprio" in remedies(Scheduling.NONE)
    assert "memlock" in remedies(Scheduling.NONE)
    assert "promised" not in timing_sentence(real_rig(), REAL_TIME)
    assert "30 ms" in timing_sentence(real_rig(), REAL_TIME)
    assert "simulated bench" in timing_sentence(rig.config.loader.load("mock"), Scheduling.NONE)


def test_scans_of_a_late_simulator_do_not_stop_a_run(
    tmp_path: Path,
) -> None:
    class Late:
        """A mock card whose plant has been delayed for a second."""

        def read(self) -> BenchScans:
            t_ns = np.array([now - 1000 * MS]) if first else np.empty(0, np.int64)
            shape = (len(t_ns), config.actuators)
            return BenchScans(t_ns, np.zeros(shape), np.zeros(shape), 0, late_ns=1000 * MS)

        def write(self, outputs: np.ndarray) -> None:  # type: ignore[type-arg]
            pass

    (tmp_path / "short.yaml").write_text(BRIEF)
    plan = prepare(str(tmp_path / "short.yaml"), "mock", RunOptions(out=tmp_path, fast=True, seed=1)).plan
    config, now = plan.config, 10**10
    for may_stop in (False, True):
        loop, first = ControlLoop(plan, Late(), time_may_stop=may_stop), True
        _, trip = loop.cycle(0, now, 1, 0, False, 0, 0)
        assert (trip is None) is may_stop


def test_stalled_time_of_a_simulated_bench_counts_towards_no_limit() -> None:
    """The set-point steps while the whole machine is repeatedly delayed by far more than `tracking_s`."""
    config = mock_rig()
    settings = control.prepare(config)
    setpoint, still = np.array([0.4e5, 0.0, 0.0]), np.zeros(3)
    tripped = {}
    for stopped in (False, True):
        state, t_ns = control.initial(settings), 10**9
        for n in range(200):
            delay_ns = 3000 * MS if n % 5 == 4 else 0
            t_ns += 5 * MS + delay_ns
            volts = np.array([0.01 * (n % 2), 0.0, 0.0])
            sample = Sample(t_ns, t_ns, volts, volts * 1e3, delay_ns, stopped)
            state, command = control.step(settings, state, sample, setpoint if n > 3 else still, still)
        tripped[stopped] = command.trip
    assert tripped[False] is not None
    assert tripped[True] is None


def test_skipped_time_of_the_plant_moves_no_pressure() -> None:
    config = mock_rig()
    plant = Plant(config, 1, 0, moving_arm=False)
    plant.set_output(0, config.valves[0].range_V[1])
    plant.advance(50 * MS)
    before = plant.pressure_pa.copy()
    plant.skip(2000 * MS)
    assert plant.t_ns >= 1990 * MS
    np.testing.assert_array_equal(plant.pressure_pa, before)


def test_a_process_without_real_time_priority_asks_for_short_slices_and_keeps_its_priority() -> None:
    program = (
        "import os\nfrom rig.realtime import scheduling\nos.nice(5)\nscheduling._request_short_slice()\n"
        "print(os.getpriority(os.PRIO_PROCESS, 0), os.sched_getscheduler(0))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == f"{min(os.nice(0) + 5, 19)} {os.SCHED_OTHER}\n"


def test_the_obtainable_scheduling_is_what_a_process_is_granted() -> None:
    program = (
        "from rig.realtime import scheduling\nexpected = scheduling.obtainable()\n"
        "print(int(expected), int(scheduling.enable_realtime_scheduling(scheduling.CONTROL_PRIORITY)))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    expected, granted = done.stdout.split()
    assert expected == granted


def test_missing_promises_of_a_real_bench_are_reported_before_arming(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prepared = prepare("ramp-a", "pci1716", RunOptions(out=tmp_path))
    for granted, promised in ((Scheduling.NONE, False), (REAL_TIME, True)):
        monkeypatch.setattr(run_output, "obtainable", lambda granted=granted: granted)
        console = Console(width=400, file=StringIO(), markup=False)
        console.print(run_output.check_screen(prepared))
        said = console.file.getvalue()  # type: ignore[attr-defined]
        assert ("no reaction time can be promised" not in said) is promised
        assert ("rtprio" not in said) is promised
