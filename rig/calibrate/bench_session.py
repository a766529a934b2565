"""Bench session for calibration: in real time with the watchdog, or in virtual time with the plant in this process."""

from __future__ import annotations

import gc
import os
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from protocols import SetPointTrajectory
from rig.calibrate.bench_driver import BenchClock, BenchDriver, TrippedError
from rig.config.schema import RigConfig
from rig.control.control_loop import ValveOutputs
from rig.execution.plan import RunPlan, StartError
from rig.hardware import running
from rig.hardware.bench import Bench, open_bench
from rig.hardware.cards.base import CardError
from rig.hardware.vent_verification import VentVerification, real_time
from rig.realtime.child_process import ChildJob, ended_within, spawn
from rig.realtime.control_process import GuardedOutputs, NullOutputs
from rig.realtime.process_monitor import ProcessMonitor
from rig.realtime.scheduling import (
    CONTROL_PRIORITY,
    HeartbeatMonitor,
    disable_realtime_scheduling,
    enable_realtime_scheduling,
    wait_until,
)
from rig.realtime.shared_state import SharedState, Stage, Stop
from rig.realtime.timing_limits import TimingLimits, timing_limits
from rig.simulator.plant import Plant

POWER_UP_NS = 100_000_000
_READY_S = 20.0
_WARM_UP_S = 0.2
_END_S = 5.0


class VirtualClock:
    """Control periods in virtual time."""

    def __init__(self, plant: Plant, period_ns: int) -> None:
        self._plant, self._period_ns, self._now = plant, period_ns, plant.t_ns

    def next(self) -> int:
        self._now += self._period_ns
        self._plant.advance(self._now)
        return self._now


class RealTimeClock:
    """Control periods of CLOCK_MONOTONIC; each sends a heartbeat to the watchdog and checks the watchdog's."""

    def __init__(self, memory: SharedState, period_ns: int, watchdog: ProcessMonitor, timing: TimingLimits) -> None:
        self._memory, self._period_ns, self._watchdog = memory, period_ns, watchdog
        self._silent_ns = timing.watchdog_silent_ns
        self._silence = HeartbeatMonitor(period_ns, self._silent_ns // 10)
        self._deadline = time.monotonic_ns()

    def next(self) -> int:
        """Wait for the next period.

        Raises:
            StartError: the watchdog has tripped, has died or is silent.
        """
        # After a delay of more than a period, missed periods are skipped.
        self._deadline = max(self._deadline + self._period_ns, time.monotonic_ns() - self._period_ns)
        now = wait_until(self._deadline)
        self._memory.heartbeat("control", now)
        self._memory.heartbeat("supervisor", now)
        if self._memory.watchdog_trip_ns:
            raise StartError(f"the watchdog took the bench over: {self._memory.message('watchdog') or 'a late cycle'}")
        if self._watchdog.exited:
            raise StartError("the watchdog process died")
        if self._silence.silent_ns(now, self._memory.heartbeat_ns("watchdog")) > self._silent_ns:
            raise StartError("the watchdog is silent")
        return now


@contextmanager
def virtual(config: RigConfig, seed: int, *, moving_arm: bool = True) -> Iterator[tuple[Bench, BenchClock, Plant]]:
    """The simulated bench in this process, armed; every card of the rig is a mock."""
    plant = Plant(config, seed, t0_ns=0, moving_arm=moving_arm)
    bench = Bench(config, {name: plant.card(name) for name in config.cards}, lambda: plant.t_ns)
    vents = False
    with bench.armed(vent=lambda: vents):
        plant.advance(POWER_UP_NS)
        try:
            yield bench, VirtualClock(plant, _period_ns(config)), plant
        except TrippedError as error:
            vents = error.trip.vent
            raise


@contextmanager
def real(config: RigConfig, rig_file: Path) -> Iterator[tuple[ValveOutputs, BenchClock]]:
    """The rig's locked cards, armed, with the watchdog of a run, which makes safe what this process cannot.

    Raises:
        CardError: a card cannot be opened, or another program has written to it.
        StartError: the watchdog does not start.
    """
    with _watched(config, rig_file) as (memory, watchdog):
        bench = open_bench(config)
        memory.card_holder_pid = os.getpid()

        def written() -> None:
            memory.publish_stage("control", Stage.DONE)
            _verify_venting(config, bench, vent=memory.vents)

        try:
            with bench.armed(vent=lambda: memory.vents, written=written):
                memory.control_granted = enable_realtime_scheduling(CONTROL_PRIORITY)
                # The first scans are on their way.
                time.sleep(POWER_UP_NS * 1e-9)
                timing = timing_limits(config, memory.granted)
                clock = RealTimeClock(memory, _period_ns(config), watchdog, timing)
                # Imports and compilation at first use make a cycle late: no valve may be open then, unwatched.
                still = NullOutputs(bench)
                warming = BenchDriver(config, still, clock, lambda: None, longest_stop_ns=timing.simulator_ns)
                warming.regulate(np.zeros(config.actuators), _WARM_UP_S)
                memory.publish_stage("control", Stage.RUNNING)
                try:
                    yield GuardedOutputs(bench, memory), clock
                except TrippedError as error:
                    memory.vented = memory.vented or error.trip.vent
                    raise
        finally:
            memory.publish_stage("control", Stage.DONE)
            bench.close()
            gc.enable()
            disable_realtime_scheduling()


def _verify_venting(config: RigConfig, bench: Bench, *, vent: bool) -> None:
    """Watch the chambers vent; raise CardError where the pressures do not confirm it."""
    verification = VentVerification(config, bench, vent=vent, since_ns=time.monotonic_ns())
    outcome = verification.outcome(real_time(lambda: None))
    if not outcome.confirmed:
        raise CardError(outcome.sentence)


@contextmanager
def _watched(config: RigConfig, rig_file: Path) -> Iterator[tuple[SharedState, ProcessMonitor]]:
    """Run the watchdog. The process that it monitors ends with this context, or when this process dies."""
    memory = SharedState.create(config)
    nothing = SetPointTrajectory(0.0, config.actuators, (), (), "")
    plan = RunPlan(config, rig_file, nothing, config.model.variant, 0)
    watchdog = spawn("rig.realtime.watchdog_process", ChildJob(plan, memory.fd, os.getpid()))
    running.listens(watchdog.pid)
    life = ProcessMonitor(watchdog.pid)
    # It ends when its input is closed: by the kernel when we die.
    stand_in = subprocess.Popen(["cat"], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, start_new_session=True)
    try:
        until = time.monotonic() + _READY_S
        while memory.stage("watchdog") not in (Stage.READY, Stage.FAILED):
            if time.monotonic() > until or watchdog.poll() is not None:
                raise StartError("the watchdog did not start")
            time.sleep(0.01)
        if memory.stage("watchdog") == Stage.FAILED:
            raise StartError(memory.message("watchdog"))
        memory.control_pid = stand_in.pid
        yield memory, life
    finally:
        memory.stop_request = Stop.SAFE
        # Not by closing its input: it may have been stopped.
        for process, patience_s in ((stand_in, 0.0), (watchdog, _END_S)):
            if not ended_within(process, patience_s):
                process.kill()
                ended_within(process, _END_S)
        assert stand_in.stdin is not None
        stand_in.stdin.close()
        life.close()


def _period_ns(config: RigConfig) -> int:
    return round(1e9 / config.control.rate_hz)
