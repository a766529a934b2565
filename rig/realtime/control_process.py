"""The control process: the loop from pressures to valves, at the control rate of the rig."""

from __future__ import annotations

import math
import signal
import time
from itertools import takewhile

import numpy as np
from numpy.typing import NDArray

from rig.control.control_loop import ControlLoop
from rig.control.plan_follower import StampedPlan
from rig.control.trigger import TriggerPulses
from rig.hardware.bench import Bench, BenchScans, open_bench
from rig.hardware.cards.base import CardError
from rig.hardware.safe_state import combined_fault
from rig.hardware.vent_verification import VentOutcome, VentVerification, real_time
from rig.realtime.child_process import (
    ChildJob,
    await_device_access,
    exit_process,
    receive_job,
    report_end,
    supervisor_monitor,
    vent_at_signal,
)
from rig.realtime.process_monitor import ProcessMonitor
from rig.realtime.scheduling import (
    CONTROL_PRIORITY,
    HeartbeatMonitor,
    disable_realtime_scheduling,
    enable_realtime_scheduling,
    wait_until,
)
from rig.realtime.shared_state import SharedState, Stage, Stop
from rig.realtime.timing_limits import timing_limits

BEFORE_START_NS = 5_000_000
WARM_UP_S = 0.05
FIRST_SCAN_S = 0.2
CLOCKS_PUBLISHED_S = 1.0


def main() -> int:
    """Arm, run, write the safe state; the valves are safe before anything is reported."""
    job, memory = receive_job()
    signal.signal(signal.SIGTERM, lambda *_: memory.request_stop(Stop.TERMINATED))
    vent_at_signal(memory)
    supervisor = supervisor_monitor(job)
    # The watchdog opens the cards first, to find out whether a card allows one process only.
    if not await_device_access(memory, supervisor, lambda: memory.stage("watchdog") is Stage.READY):
        memory.publish_stage("control", Stage.DONE)
        return 0
    memory.heartbeat("control", time.monotonic_ns())
    try:
        bench = open_bench(job.plan.config)
    except CardError as error:
        memory.publish_stage("control", Stage.FAILED, str(error))
        return 1
    fault = ""
    crash: Exception | None = None
    try:
        with bench.armed(vent=lambda: memory.vents, written=memory.publish_safe) as unverified:
            memory.unverified_cards = len(unverified)
            _warm_up(job, bench)
            memory.publish_clocks(bench.clocks)
            memory.control_granted = enable_realtime_scheduling(CONTROL_PRIORITY)
            memory.publish_stage("control", Stage.READY)
            fault = _run(job, memory, bench, supervisor)
    except CardError as error:
        fault = combined_fault(fault, str(error))
    except Exception as error:
        crash, fault = error, f"the control process failed: {type(error).__name__}: {error}"
    if memory.safe_ns:
        if failure := bench.safe_state.trigger_failure:
            fault = combined_fault(fault, failure)
        vented = _verify_venting(job, memory, bench)
        if supervisor.exited:
            report_end("", lambda: vented)
        # Pressures that cannot be read here may be readable by the supervisor, which opens the cards again.
        if not vented.confirmed and vented.answered and not memory.watchdog_trip_ns:
            fault = combined_fault(fault, vented.sentence)
    memory.publish_stage("control", Stage.FAILED if fault else Stage.DONE, fault)
    bench.close()
    disable_realtime_scheduling()
    if crash is not None:
        raise crash  # for its traceback; no process waits for it
    return 1 if fault else 0


def _verify_venting(job: ChildJob, memory: SharedState, bench: Bench) -> VentOutcome:
    """Watch the chambers vent and publish what confirms the safe state."""
    patience_s = timing_limits(job.plan.config, memory.granted).vented_s
    venting = VentVerification(
        job.plan.config,
        ViewedReadings(bench, memory),
        vent=memory.vents,
        patience_s=patience_s,
        since_ns=memory.safe_ns,
    )
    clock = real_time(lambda: memory.heartbeat("control", time.monotonic_ns()))
    # The watchdog ends this process at once after its trip; the supervisor then verifies.
    outcome = venting.outcome(takewhile(lambda _: not memory.watchdog_trip_ns, clock))
    if outcome.confirmed:
        memory.confirmation = outcome.sentence
    return outcome


class ViewedReadings:
    """Readings of a bench in its safe state, published to viewers."""

    def __init__(self, bench: Bench, memory: SharedState) -> None:
        self._bench, self._ring = bench, memory.venting

    def read(self) -> BenchScans:
        """Read the scans since the last call."""
        scans = self._bench.read()
        if len(scans.t_ns):
            self._ring.push(np.array((scans.t_ns[-1], scans.pressure_pa[-1]), self._ring.dtype))
        return scans


class NullOutputs:
    """Outputs of a bench that ignore every write."""

    def __init__(self, bench: Bench) -> None:
        self.read = bench.read

    def write(self, outputs: NDArray[np.float64]) -> None:
        """Write nothing."""


class GuardedOutputs:
    """Outputs of a bench that are written only while no other program has written to them.

    Another program that writes to the card, such as `rig vent`, has priority.
    """

    def __init__(self, bench: Bench, memory: SharedState) -> None:
        self.read = bench.read
        self._bench, self._memory = bench, memory

    def write(self, outputs: NDArray[np.float64]) -> None:
        """Set every valve; raises as `undisturbed`."""
        # Checked immediately before the write: a process that stalled within a cycle must not undo external writes.
        if self.undisturbed():
            self._bench.write(outputs)

    def undisturbed(self) -> bool:
        """True if the outputs have the values that this run wrote; False if its own watchdog has written others.

        Raises:
            CardError: another program has moved them; if that vented them, the run ends vented.
        """
        external_write = self._bench.external_write()
        if external_write and not (self._memory.vents or self._memory.watchdog_trip_ns):
            self._memory.vented = self._bench.vented
            raise CardError(external_write)
        return not external_write


def _warm_up(job: ChildJob, bench: Bench) -> None:
    """Run some cycles without writing to the valves, so that imports and compilation are done before the start."""
    loop = ControlLoop(job.plan, NullOutputs(bench))
    period_s = loop.period_ns * 1e-9
    # A cycle without a scan would end at the check for stale samples.
    until = time.monotonic() + FIRST_SCAN_S
    while not loop.read_scans() and time.monotonic() < until:
        time.sleep(period_s)
    for number in range(math.ceil(WARM_UP_S / period_s)):
        loop.cycle(number, time.monotonic_ns(), 1, 0, False, 0, 0)
        time.sleep(period_s)


def _run(job: ChildJob, memory: SharedState, bench: Bench, supervisor: ProcessMonitor) -> str:
    """Run the loop until the protocol ends or a stop is requested; return the fault, empty if there is none."""
    valves = GuardedOutputs(bench, memory)
    timing = timing_limits(job.plan.config, memory.granted)
    loop = ControlLoop(job.plan, valves, time_may_stop=timing.simulator_ns is not None)
    period, cards = loop.period_ns, list(job.plan.config.cards)
    clocks_cycles = max(1, round(CLOCKS_PUBLISHED_S * 1e9 / period))
    trigger = TriggerPulses(job.plan.config, bench, time.monotonic_ns) if job.plan.config.triggered else None
    ended = _await_start(memory, loop, trigger, supervisor)
    if ended is not None:
        return ended
    start_ns = memory.start_ns
    memory.heartbeat("control", time.monotonic_ns())
    memory.publish_stage("control", Stage.RUNNING)
    if trigger is not None:
        trigger.restart()
    cycle = skipped = skips = 0
    watchdogs = HeartbeatMonitor(period, timing.watchdog_silent_ns // 10)
    while True:
        deadline = start_ns + cycle * period
        now = wait_until(deadline)
        if memory.stop_request != Stop.NONE:
            valves.undisturbed()  # `rig vent` requests a stop, too: its writes are reported and kept
            return ""
        if memory.watchdog_trip_ns:
            return "the watchdog took the bench over"
        if supervisor.exited:
            return "the supervisor died"
        if watchdogs.silent_ns(now, memory.heartbeat_ns("watchdog")) > timing.watchdog_silent_ns:
            return "the watchdog is silent"
        if trigger is not None:
            _pulse(trigger, cycle, memory)
        while skips < memory.skips:
            skips += 1
            loop.skip()
        for plan in memory.new_plans.read() if job.plan.controls_tip else ():
            memory.plans.push(loop.take_plan(StampedPlan.of(plan), plan["row"]))
        for setpoint in memory.new_setpoints.read() if job.plan.trajectory.streams else ():
            memory.streamed.push(loop.take_setpoint(setpoint, now))
        row, trip = loop.cycle(cycle, now, 1 + skipped, memory.prompts_answered, memory.paused, now - deadline, skipped)
        memory.samples.push(row)
        memory.lost_scans = loop.readings.lost
        memory.damaged_lines = loop.readings.damaged
        memory.repeated_scans = loop.readings.repeated
        call = bench.longest_call()
        if call is not None and call.took_ns > period:
            memory.slow_call, memory.slow_call_ns = call.number, call.took_ns
            memory.slow_card = cards.index(call.cards[0]) if len(call.cards) == 1 else -1
            memory.slow_calls += 1
        memory.setpoint_source = loop.setpoint_source
        if cycle % clocks_cycles == 0:
            memory.publish_clocks(bench.clocks)
        memory.protocol_s = loop.position.protocol_s
        memory.waiting_prompt = loop.position.prompts_passed if loop.position.waiting else -1
        memory.heartbeat("control", now)
        if trip is not None:
            # Before the safe state is written: the watchdog, too, then vents.
            memory.vented = memory.vented or trip.vent
            valves.undisturbed()
            return trip.message
        if loop.finished:
            return ""
        # A deadline is missed if its cycle has not begun before the next one is due.
        following = max(cycle + 1, (time.monotonic_ns() - start_ns) // period)
        skipped = following - cycle - 1
        cycle = following


def _await_start(
    memory: SharedState, loop: ControlLoop, trigger: TriggerPulses | None, supervisor: ProcessMonitor
) -> str | None:
    """Read scans until the run is about to begin; return the fault if it does not begin, empty for a requested stop."""
    began = time.monotonic_ns()
    while not (start_ns := memory.start_ns) or time.monotonic_ns() < start_ns - BEFORE_START_NS:
        loop.read_scans()
        memory.heartbeat("control", time.monotonic_ns())
        if trigger is not None and not start_ns:
            # The observer needs pictures before the run begins.
            _pulse(trigger, (time.monotonic_ns() - began) // loop.period_ns, memory)
        time.sleep(0.002)
        if memory.stop_request != Stop.NONE:
            return ""
        if supervisor.exited:
            return "the supervisor died before the run began"
    return None


def _pulse(trigger: TriggerPulses, cycle: int, memory: SharedState) -> None:
    """Set the camera trigger for one cycle, and publish the pulse that begins."""
    row = trigger.cycle(cycle)
    if row is not None:
        memory.pulses.push(row)


if __name__ == "__main__":
    exit_process(main())
