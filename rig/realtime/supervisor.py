"""The supervisor of a real-time run: starts the processes, supervises the run and ends it in order."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

from rig.execution.plan import OpenRecord, OperatorInterface, RunPlan, StartError, StoppedError
from rig.execution.stop_signals import VENTED
from rig.hardware.cards.base import CardError, card_type
from rig.hardware.safe_state import armed_sentence
from rig.realtime.child_process import require_libraries
from rig.realtime.data_recorder import DataRecorder
from rig.realtime.failsafe import Shutdown
from rig.realtime.operator_session import OperatorSession
from rig.realtime.outcome import Ending, EndOfRun, outcome
from rig.realtime.process_group import PROCESSES, WATCHDOG_TRIPPED, ProcessGroup
from rig.realtime.scheduling import PLANNING_NICENESS, REAL_TIME, Scheduling, obtainable, remedies, steal_time_ms
from rig.realtime.shared_state import TIP_CONTROLLER, SharedState, Stage, Stop
from rig.realtime.timing_limits import TimingProfile, timing_limits, timing_sentence
from rig.simulator.plant_launcher import PlantProcess, started
from rig.tip_control.monitor import LOST_S, TipControlMonitor
from rig.tip_control.monitor import SOURCE as TIP_CONTROLLER_SOURCE
from runs.records import Event, Level, RunFooter, Status

SLOW_START_S = 4.0
START_TIMEOUT_S = 300.0
"""Long, because a cold compiler cache or a busy machine is not a fault."""
START_DELAY_NS = 60_000_000
START_POLL_S = 0.005
PERIOD_S = 0.02
LAST_FRAME_TIMEOUT_S = 0.5
CONTROLLER_SILENT_NS = round(LOST_S * 0.5e9)
"""Time without a heartbeat from which the tip controller counts as hung, if there are no plans."""

STOP_MESSAGES = {
    Stop.SAFE: "a stop of the run was requested",
    Stop.SILENT: "the supervisor had been silent, and the other processes were requested to make the bench safe",
    Stop.TERMINATED: "the control process received SIGTERM",
    Stop.VENT: "venting was requested",
    Stop.VENT_COMMAND: VENTED,
}


def run(plan: RunPlan, open_record: OpenRecord, operator: OperatorInterface) -> RunFooter:
    """Run one plan in real time; return once the valves are safe and every process has ended.

    Raises:
        CardError, StartError: a device or a process did not start.
        ModuleNotFoundError: a library of the processes is not installed.
    """
    require_libraries()
    expected = obtainable()
    waits_ns = timing_limits(plan.config, expected).simulation_waits_ns
    with started(plan.config, plan.rig_file, plan.seed, waits_ns) as plant:
        supervisor = Supervisor(plan, operator, plant, expected)
        try:
            footer = supervisor.run(open_record)
        except BaseException as error:
            failure = (
                supervisor.end() or supervisor.control_failure or supervisor.shutdown.unconfirmed(supervisor.timing)
            )
            if failure and failure not in str(error) and isinstance(error, Exception):
                raise CardError(f"{error}; {failure}") from error
            raise
        status, message = Ending(footer.status, footer.message).aborted(supervisor.end())
        return replace(footer, status=status, message=message)


class Supervisor:
    """Supervises one run: `run`, then `end`."""

    def __init__(
        self,
        plan: RunPlan,
        operator: OperatorInterface,
        plant: PlantProcess | None,
        expected: Scheduling = Scheduling.NONE,
    ) -> None:
        """`plant` is the simulated plant, if the rig has one; `expected` is the scheduling that can be had."""
        self.timing = timing_limits(plan.config, expected)
        self.memory = SharedState.create(plan.config, len(plan.adapted))
        self.processes = ProcessGroup(plan, self.memory, plant, PERIOD_S)
        self.shutdown = Shutdown(plan.config, self.memory, self.processes)
        self._tip_monitor, self._tip_failure = TipControlMonitor(), ""
        self._started = (*PROCESSES, TIP_CONTROLLER) if plan.controls_tip else PROCESSES
        self.record: DataRecorder
        self._plan, self._plant, self._operator = plan, plant, operator
        self._session = OperatorSession(plan, self.memory, operator, self._event)

    def run(self, open_record: OpenRecord) -> RunFooter:
        """Start the processes, supervise the run, make the valves safe.

        Raises:
            StartError: a process did not start, or the operator stopped the start.
        """
        self._start(open_record)
        stolen = steal_time_ms()
        try:
            ending = self.supervise()
        finally:
            self.shutdown.await_safe_state(self.timing)
        # The last frame is still being measured, and the live page may have shown it already: it belongs in the record.
        self.processes.await_exit("observer", LAST_FRAME_TIMEOUT_S)
        self.record.finish()
        status, message = self._outcome(ending)
        self.memory.publish_stage("supervisor", Stage.DONE, f"{status}: {message}".removesuffix(": "))
        return self._footer(status, message, steal_time_ms() - stolen)

    @property
    def control_failure(self) -> str:
        """Message of a failed control process, such as a chamber that does not vent; else empty."""
        return self.memory.message("control") if self.memory.stage("control") is Stage.FAILED else ""

    def end(self) -> str:
        """End every child process; may be called at any time. Returns what is wrong with the valves, else empty."""
        self.memory.request_stop(Stop.SAFE)
        self._session.close()
        killed = self.processes.end(self.timing.ending_s)
        if self.shutdown.pending:
            return self.shutdown.force()
        if "watchdog" in killed:
            return "the watchdog did not end; check the valves and run `rig vent --rig` with this rig"
        return ""

    def supervise(self) -> Ending:
        """Record and supervise until the run ends; return its status and the reason."""
        memory = self.memory
        while True:
            memory.heartbeat("supervisor", time.monotonic_ns())
            # Read before the reasons: after a stall in between, control would be done without a reason.
            done = memory.stage("control") == Stage.DONE
            self.record.poll()
            if ending := self._session.end_requested():
                return ending
            if (stop := memory.stop_request) is Stop.VENT_COMMAND:
                return Ending(Status.INTERRUPTED, STOP_MESSAGES[stop])
            if stop is not Stop.NONE:
                self._event(Level.FAULT, "supervisor", STOP_MESSAGES[stop])
                return Ending(Status.ABORTED, STOP_MESSAGES[stop])
            if fault := self.processes.fault(self.timing):
                # First of all, because the exit of a process may take long.
                self.shutdown.await_safe_state(self.timing)
                fault = self.processes.completed(fault, self.timing)
                self._event(Level.FAULT, fault.source, fault.message)
                return Ending(Status.ABORTED, fault.message).aborted(self._tip_monitor.loss)
            if failure := self.record.failure:
                return Ending(Status.ABORTED, failure)
            self.record.report(*self._tip_control_events(time.monotonic_ns()))
            if done:
                return Ending(Status.FINISHED, self._tip_monitor.message(self.record.totals.plans))
            self._session.update(self.record)
            if self._plant is not None:
                self._plant.set_tip_weight(self._plan.trajectory.weight_kg(memory.protocol_s))
            self._session.serve(PERIOD_S)

    def _tip_control_events(self, t_ns: int) -> Iterator[Event]:
        """What has changed since the last call, by what the tip controller's process and the shared memory say."""
        if not self._tip_failure and (fault := self.processes.failure((TIP_CONTROLLER,))):
            self._tip_failure = self.processes.explained(fault)
        memory = self.memory
        responds = t_ns - memory.heartbeat_ns(TIP_CONTROLLER) < CONTROLLER_SILENT_NS
        return self._tip_monitor.events(
            t_ns, memory.protocol_s, memory.setpoint_source, self._tip_failure, responds=responds
        )

    def await_ready(self, name: str) -> None:
        """Wait until a starting process, or the "simulator", is ready.

        Raises:
            StartError: it or another process failed, or the operator stopped the start.
        """
        began = time.monotonic()
        reported = False
        while not self.processes.ready(name):
            self.memory.heartbeat("supervisor", time.monotonic_ns())
            self._check_start()
            waited = time.monotonic() - began
            if waited > SLOW_START_S and not reported:
                reported = True
                stopped = self.processes.stopped(name)
                why = "it was stopped" if stopped else "after a new version it compiles its kernels once"
                message = f"waiting for the {name} process: {why}"
                self._operator.report(Event(time.monotonic_ns(), Level.INFO, "supervisor", message))
            if waited > START_TIMEOUT_S:
                raise StartError(f"the {name} process was not ready within {START_TIMEOUT_S:.0f} s")
            self._session.serve(START_POLL_S)
        self._check_start()

    def _check_start(self) -> None:
        """Raise if the run must not begin: a stop was requested, or a starting process has failed."""
        if reason := self._session.start_cancelled():
            raise StoppedError(f"stopped before the run began: {reason}")
        if self.memory.stop_request is Stop.VENT_COMMAND:
            raise StoppedError(f"stopped before the run began: {VENTED}")
        if fault := self.processes.failure():
            message = self.processes.explained(fault)
            raise StartError(message.replace("process died", "process died while it started"))
        if (stop := self.memory.stop_request) != Stop.NONE:
            raise StartError(f"before the run began, {STOP_MESSAGES[stop]}")

    def _start(self, open_record: OpenRecord) -> None:
        """Start every process, open the record, and set the time of the first control cycle."""
        memory, config = self.memory, self._plan.config
        unattachable = self._session.open()
        memory.heartbeat("supervisor", time.monotonic_ns())
        memory.simulator_starting = self._plant is not None
        for name in self._started:
            self.processes.start(name)
        for card in config.cards.values():
            card_type(card)  # loaded in advance: an emergency leaves no time for imports
        self.await_ready("simulator")
        memory.simulator_starting = False
        for name in self._started:
            self.await_ready(name)
        self.timing = timing_limits(config, memory.granted)
        start_ns = time.monotonic_ns() + START_DELAY_NS
        journal = open_record(start_ns)
        memory.journal = journal.path
        self.record = DataRecorder(self._plan, memory, journal, self._operator, start_ns)
        self._event(Level.INFO, "control", armed_sentence(memory.unverified_cards))
        self._report_timing()
        self._raise_controller_priority()
        if unattachable:
            self._event(Level.WARNING, "supervisor", unattachable)
        memory.heartbeat("supervisor", time.monotonic_ns())
        memory.start_ns = max(start_ns, time.monotonic_ns() + START_DELAY_NS // 10)

    def _report_timing(self) -> None:
        """Record the granted scheduling and the resulting time limits."""
        granted = self.memory.granted
        if refused := remedies(granted):
            self._event(Level.WARNING, "control", refused)
        level = Level.WARNING if self.timing.profile is TimingProfile.ORDINARY else Level.INFO
        if self.timing.profile is not TimingProfile.STRICT or REAL_TIME not in granted:
            self._event(level, "supervisor", timing_sentence(self._plan.config, granted))

    def _raise_controller_priority(self) -> None:
        """Raise the tip controller's priority, where control is above it and it is permitted; record what it has.

        Without SCHED_FIFO for control and watchdog the controller, which may run code of the user, stays beside them.
        """
        if TIP_CONTROLLER not in self._started or Scheduling.FIFO not in self.memory.granted:
            return
        niceness = self.processes.set_niceness(TIP_CONTROLLER, PLANNING_NICENESS)
        if niceness is not None:
            late = "" if niceness <= PLANNING_NICENESS else ": on a busy machine its plans may be late"
            self._event(Level.INFO, TIP_CONTROLLER_SOURCE, f"the tip controller runs with niceness {niceness}{late}")

    def _outcome(self, ending: Ending) -> Ending:
        """Verify the safe state and return the outcome of the run."""
        memory = self.memory
        # Also after another fault: a chamber that does not vent is always reported.
        failures = [("control", self.control_failure)]
        if memory.watchdog_trip_ns and ending.status is not Status.ABORTED and not self.control_failure:
            failures = [("watchdog", memory.message("watchdog") or WATCHDOG_TRIPPED)]
        unsafe = self.shutdown.verify(self.timing)
        if written := self.shutdown.written_message:
            self._event(Level.FAULT, "supervisor", written)
        writer = "supervisor" if written or unsafe else "control" if memory.safe_ns else "watchdog"
        end = EndOfRun(lambda: self.shutdown.confirm(self.timing), tuple(failures), unsafe, writer)
        return outcome(ending, end, self._event).aborted(self.record.failure)

    def _footer(self, status: Status, message: str, stolen: int) -> RunFooter:
        memory = self.memory
        counters = {
            **self.record.counters(),
            **self._session.stream.counts,
            "stolen_cpu_ms": stolen,
            **memory.clock_counters(self._plan.config.cards),
        }
        safe_ns = memory.safe_ns or memory.watchdog_trip_ns
        return RunFooter(safe_ns or time.monotonic_ns(), status, message, counters)

    def _event(self, level: Level, source: str, message: str) -> None:
        self.record.event(level, source, message)
