"""The supervisor of a real-time run: starts the processes, records their data and ends the run in order."""

from __future__ import annotations

import os
import subprocess
import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rig.execution.plan import (
    OpenRecord,
    OperatorInterface,
    Outcome,
    Plan,
    Progress,
    Recorder,
    StartError,
    StoppedError,
)
from rig.hardware.bench import UNSAFE
from rig.hardware.cards.base import CardError
from rig.hardware.cards.registry import card_type
from rig.hardware.safe_state import unsafe_output
from rig.realtime import sampling_clocks
from rig.realtime.child_process import ChildJob, ended_within, spawn
from rig.realtime.control_socket import ControlSocket
from rig.realtime.failsafe import force_safe_state
from rig.realtime.health_monitor import HealthMonitor
from rig.realtime.operator_commands import CommandHandler, CommandKind, CommandResult, OperatorCommand, user_name
from rig.realtime.process_monitor import ProcessMonitor
from rig.realtime.scheduling import REAL_TIME, HeartbeatMonitor, Scheduling, obtainable, stolen_ms
from rig.realtime.shared_state import SharedState, Stage, StateLayout, Stop
from rig.realtime.timing_limits import TimingProfile, remedies, stated, timing_limits
from rig.simulator.plant_launcher import Simulation, started
from runs.records import Event, Level, Status

SLOW_START_S = 4.0
START_TIMEOUT_S = 300.0
"""Long, because a cold compiler cache or a busy machine is not a fault."""
LEAD_NS = 60_000_000
START_LOOK_S = 0.005
DRAIN_S = 0.02
SHOW_S = 0.1
LAST_FRAME_S = 0.5
STATUS_S = 1.0
"""Time for an exiting process to release its memory: its exit status is known only then."""
OVERSLEPT_NS = 200_000_000
TAKEN_OVER = "the watchdog took the bench over, and exited before it could report why"

STOPPED = {
    Stop.SAFE: "a stop of the run was requested",
    Stop.SILENT: "the supervisor had been silent, and the other processes were requested to make the bench safe",
    Stop.TERMINATED: "the control process received SIGTERM",
    Stop.VENT: "venting was requested",
}


def run(plan: Plan, open_record: OpenRecord, operator: OperatorInterface) -> Outcome:
    """Run one plan in real time; return once the valves are safe and every process has ended.

    Raises:
        CardError, StartError: a device or a process did not start.
    """
    expected = obtainable()
    waits_ns = timing_limits(plan.config, expected).simulation_waits_ns
    with started(plan.config, plan.rig_file, plan.seed, waits_ns) as plant:
        supervisor = _Supervisor(plan, operator, plant, expected)
        try:
            outcome = supervisor.run(open_record)
        except BaseException as error:
            trouble = supervisor.end() or supervisor.control_failure
            if trouble and trouble not in str(error) and isinstance(error, Exception):
                raise CardError(f"{error}; {trouble}") from error
            raise
        if trouble := supervisor.end():
            message = f"{outcome.message}; {trouble}".removeprefix("; ")
            return replace(outcome, status=Status.ABORTED, message=message)
        return outcome


class _Supervisor:
    def __init__(
        self, plan: Plan, operator: OperatorInterface, plant: Simulation | None, expected: Scheduling = Scheduling.NONE
    ) -> None:
        self.plan = plan
        self.plant = plant
        self.timing = timing_limits(plan.config, expected)
        self.recorder: Recorder
        self.operator = operator
        self.memory = SharedState.create(StateLayout.of(plan.config, len(plan.adapted)))
        self.command_handler = CommandHandler(self.memory, plan.trajectory)
        self.control_socket: ControlSocket | None = None
        self.children: dict[str, subprocess.Popen[bytes]] = {}
        self.monitors: dict[str, ProcessMonitor] = {}
        self._failsafe_message = ""
        self._judged = False
        self.health_monitor = HealthMonitor(plan.config)
        self.lost_scans = 0
        # After a stall of the whole machine every process gets time to send a heartbeat.
        self.heartbeat_monitors = {
            name: HeartbeatMonitor(round(DRAIN_S * 1e9), OVERSLEPT_NS) for name in ("observer", "control", "watchdog")
        }
        self.missed = 0
        self.dropped = 0
        self._sample: NDArray[np.void] | None = None
        self._observation: NDArray[np.void] | None = None
        self._adaptation: NDArray[np.void] | None = None
        self._shown_prompt = -1

    def run(self, open_record: OpenRecord) -> Outcome:
        """Start the processes, supervise the run, end it."""
        memory = self.memory
        trouble = self._open_control_socket()
        memory.heartbeat("supervisor", time.monotonic_ns())
        memory.simulator_starting = self.plant is not None
        for name in ("watchdog", "control", "observer"):
            self._spawn(name, f"rig.realtime.{name}_process")
        for card in self.plan.config.cards.values():
            card_type(card)  # loaded in advance: an emergency leaves no time for imports
        self._await("simulator")
        memory.simulator_starting = False
        for name in self.children:
            self._await(name)
        self.timing = timing_limits(self.plan.config, memory.granted)
        stolen = stolen_ms()
        go = time.monotonic_ns() + LEAD_NS
        self.recorder = open_record(go)
        self._event(Level.INFO, "control", "armed: the safe state was written and read back")
        for sentence in sampling_clocks.descriptions(memory, self.plan.config):
            self._event(Level.INFO, "card", sentence)
        self._report_timing()
        if trouble:
            self._event(Level.WARNING, "supervisor", trouble)
        memory.heartbeat("supervisor", time.monotonic_ns())
        memory.start_ns = max(go, time.monotonic_ns() + LEAD_NS // 10)
        try:
            status, message = self._supervise()
        finally:
            self._make_safe()
        # The last frame is still being measured, and the live page may have shown it already: it belongs in the record.
        ended_within(self.children["observer"], LAST_FRAME_S)
        self._drain()
        # Also after another fault: a chamber that does not vent is always reported.
        if self.control_failure not in message:
            status, message = Status.ABORTED, f"{message}; {self.control_failure}".removeprefix("; ")
            self._event(Level.FAULT, "control", self.control_failure)
        if memory.watchdog_trip_ns and status is not Status.ABORTED:
            status, message = Status.ABORTED, memory.message("watchdog") or TAKEN_OVER
        safe_ns = memory.safe_ns or memory.watchdog_trip_ns
        trouble = self._unsafe()
        if self._failsafe_message:
            self._event(Level.FAULT, "supervisor", self._failsafe_message)
        if trouble:
            status = Status.ABORTED
            message = message if UNSAFE in message else f"{message}; {trouble}".removeprefix("; ")
            self._event(Level.FAULT, "watchdog", trouble)
        else:
            writer = "supervisor" if self._failsafe_message else "control" if memory.safe_ns else "watchdog"
            self._event(Level.INFO, writer, "the valves are in their safe state")
        counters = {
            "missed_deadlines": self.missed,
            "dropped_frames": self.dropped,
            "lost_scans": self.lost_scans,
            "sample_ring_overflows": memory.samples.lost,
            "observation_ring_overflows": memory.observations.lost,
            "picture_ring_overflows": memory.pictures_lost,
            "stolen_cpu_ms": stolen_ms() - stolen,
            **sampling_clocks.clock_counters(memory, self.plan.config),
        }
        memory.publish_stage("supervisor", Stage.DONE, f"{status}: {message}".removesuffix(": "))
        return Outcome(status, message, safe_ns or time.monotonic_ns(), counters)

    def _report_timing(self) -> None:
        """Record the granted scheduling and the resulting time limits."""
        granted = self.memory.granted
        if refused := remedies(granted):
            self._event(Level.WARNING, "control", refused)
        level = Level.WARNING if self.timing.profile is TimingProfile.ORDINARY else Level.INFO
        if self.timing.profile is not TimingProfile.STRICT or REAL_TIME not in granted:
            self._event(level, "supervisor", stated(self.plan.config, granted))

    @property
    def control_failure(self) -> str:
        """Message of a failed control process, such as a chamber that does not vent; else empty."""
        return self.memory.message("control") if self.memory.stage("control") is Stage.FAILED else ""

    def end(self) -> str:
        """End every child process; may be called at any time. Returns what is wrong with the valves, else empty."""
        memory = self.memory
        memory.request_stop(Stop.SAFE)
        if self.control_socket is not None:
            self.control_socket.close()
        if memory.simulator_starting:
            # No child has opened a device yet; while they load they do not check for a stop request.
            for process in self.children.values():
                process.kill()
        message = ""
        # The watchdog ends last: it writes the safe state when the others cannot.
        for name, process in sorted(self.children.items(), key=lambda member: member[0] == "watchdog"):
            if not ended_within(process, self.timing.ending_s):
                process.kill()
                # A time-out, because the exit of a traced process is hidden until its debugger collects it.
                ended_within(process, STATUS_S)
                if name == "watchdog":
                    message = "the watchdog did not end; check the valves and run `rig vent --rig` with this rig"
        for monitor in self.monitors.values():
            monitor.close()
        # Control sends its first heartbeat before it opens a card; before that no valve has moved.
        if not self._judged and memory.heartbeat_ns("control") and not self._written():
            trouble = force_safe_state(self.plan.config, memory)
            return trouble if not trouble or UNSAFE in trouble else f"{UNSAFE}: {trouble}"
        return message

    def _supervise(self) -> tuple[Status, str]:
        memory = self.memory
        shown = 0.0
        while True:
            memory.heartbeat("supervisor", time.monotonic_ns())
            # Read before the reasons: after a stall in between, control would be done without a reason.
            done = memory.stage("control") == Stage.DONE
            self._report(*self.health_monitor.looking(time.monotonic_ns()))
            self._drain()
            self._report(*self.health_monitor.disk(time.monotonic_ns(), self.recorder.stalled_s))
            if reason := self.operator.stop_requested():
                return Status.INTERRUPTED, reason
            if self.operator.pause_toggled():
                wish = CommandKind.RESUME if memory.paused else CommandKind.PAUSE
                self._handle(OperatorCommand(wish, f"{user_name()} (terminal)"))
            if self.command_handler.ending is not None:
                return self.command_handler.ending
            if (stop := memory.stop_request) != Stop.NONE:
                self._event(Level.FAULT, "supervisor", STOPPED[stop])
                return Status.ABORTED, STOPPED[stop]
            if fault := self._fault():
                # Evaluated before a silent process is killed: its exit status would not show the cause.
                died = self._died(fault[0])
                # First of all, because the exit of a process may take long.
                self._make_safe()
                fault = self._explained(*fault, died=died)
                self._event(Level.FAULT, *fault)
                return Status.ABORTED, fault[1]
            if done:
                return Status.FINISHED, ""
            self._prompt()
            if self.plant is not None:
                self.plant.hang(self.plan.trajectory.weight_kg(memory.protocol_s))
            if (now := time.monotonic()) - shown > SHOW_S:
                shown = now
                self.operator.show(self._progress())
            self._serve(DRAIN_S)

    def _open_control_socket(self) -> str:
        """Open the control socket; return why pages cannot attach, else empty."""
        try:
            self.control_socket = ControlSocket(self.plan, self.memory)
        except OSError as error:
            return f"no page can watch this run: {error}"
        return ""

    def _serve(self, timeout_s: float) -> None:
        if self.control_socket is None:
            time.sleep(timeout_s)
        else:
            self.control_socket.serve(timeout_s, self._handle)

    def _handle(self, request: OperatorCommand) -> CommandResult:
        """Execute a command of an operator, then record it."""
        if not self.memory.start_ns and request.action not in (CommandKind.STOP, CommandKind.VENT):
            return CommandResult(False, "the run has not begun")
        answer = self.command_handler.handle(request)
        if answer.accepted and self.memory.start_ns:
            self._event(Level.INFO, "operator", answer.message)
        return answer

    def _fault(self) -> tuple[str, str] | None:
        """A process with a fault, and the fault; None if there is none."""
        memory = self.memory
        if memory.watchdog_trip_ns:
            return "watchdog", TAKEN_OVER
        if fault := self._lost():
            return fault
        if self.plant is not None and self.plant.exit_status is not None:
            return "simulator", f"the simulator died (exit status {self.plant.exit_status})"
        now = time.monotonic_ns()
        timing = self.timing
        patience_s = {
            "observer": timing.supervised_observer_s,
            "control": timing.supervised_control_s,
            "watchdog": timing.supervised_watchdog_s,
        }
        silent_s = {
            name: self.heartbeat_monitors[name].silent_ns(now, memory.heartbeat_ns(name)) * 1e-9 for name in patience_s
        }
        ended = memory.stage("control") in (Stage.DONE, Stage.FAILED)
        for name in ("observer",) if ended else patience_s:
            if silent_s[name] > patience_s[name]:
                return name, f"the {name} process has been silent for {silent_s[name]:.1f} s"
        if self.plant is not None and timing.simulator_ns is not None and not ended:
            late_ns = self.plant.late_ns(now)
            if late_ns > timing.simulator_ns:
                return "simulator", f"the simulator has stalled for {late_ns * 1e-9:.1f} s"
        return None

    def _lost(self) -> tuple[str, str] | None:
        """A process that has failed or died, and the message; None if there is none."""
        for name, monitor in self.monitors.items():
            exited, stage = monitor.exited, self.memory.stage(name)
            if stage is Stage.FAILED:
                return name, self.memory.message(name)
            if exited and stage is not Stage.DONE:
                return name, f"the {name} process died"
        return None

    def _explained(self, source: str, message: str, *, died: bool) -> tuple[str, str]:
        """The source and message of a fault, completed once the valves are safe."""
        if self.memory.watchdog_trip_ns:
            # The reason of the watchdog comes first: other faults may follow from it. It is published at its end.
            ended_within(self.children["watchdog"], self.timing.ending_s)
            return "watchdog", self.memory.message("watchdog") or message
        return source, message + (self._exit_status(source) if died else "")

    def _died(self, name: str) -> bool:
        """True for a process that has exited without a message."""
        return name in self.monitors and self.monitors[name].exited and self.memory.stage(name) <= Stage.RUNNING

    def _exit_status(self, name: str) -> str:
        """Exit status of a process that has died, as a suffix of its message."""
        return f" (exit status {self.children[name].returncode})" if ended_within(self.children[name], STATUS_S) else ""

    def _drain(self) -> None:
        """Record everything that the processes have written since the last call."""
        samples = self.memory.samples.read()
        if len(samples):
            self.recorder.samples(samples)
            self.missed += int(samples["missed"].sum())
            self._sample = samples[-1]
            self._report(*self.health_monitor.samples(samples))
        lost, self.lost_scans = self.memory.lost_scans - self.lost_scans, self.memory.lost_scans
        self._report(*self.health_monitor.lost(time.monotonic_ns(), lost))
        observations = self.memory.observations.read()
        if len(observations):
            self.recorder.observations(observations)
            self.dropped += int(observations["dropped"].sum())
            self._observation = observations[-1]
            self._report(*self.health_monitor.observations(observations))
        adaptations = self.memory.adaptations.read()
        if len(adaptations):
            self.recorder.adaptations(adaptations)
            self._adaptation = adaptations[-1]
        for picture in self.memory.read_pictures(list(self.plan.config.cameras), self.plan.config.recording.encoding):
            self.recorder.picture(picture)

    def _prompt(self) -> None:
        waiting = self.memory.waiting_prompt
        if waiting < 0:
            return
        if waiting != self._shown_prompt:
            self._shown_prompt = waiting
            self._event(Level.INFO, "protocol", f"waiting for the operator: {self._prompt_text(waiting)}")
            self.operator.show(self._progress())
        elif self.memory.prompts_answered <= waiting and self.operator.answered():
            self.memory.prompts_answered = waiting + 1
            self._event(Level.INFO, "operator", f"done: {self._prompt_text(waiting)}")

    def _prompt_text(self, index: int) -> str:
        return self.plan.trajectory.prompts[index].message

    def _progress(self) -> Progress:
        waiting = self.memory.waiting_prompt
        return Progress(
            protocol_s=self.memory.protocol_s,
            duration_s=self.plan.trajectory.duration_s,
            sample=self._sample,
            observation=self._observation,
            missed=self.missed,
            dropped=self.dropped,
            prompt=self._prompt_text(waiting) if waiting >= 0 else None,
            held=self.memory.paused,
            adapted=self.plan.adapted,
            adaptation=self._adaptation,
        )

    def _make_safe(self) -> None:
        """Request the safe state and wait until control or the watchdog has written it; otherwise write it."""
        memory = self.memory
        memory.request_stop(Stop.SAFE)
        deadline = time.monotonic() + self.timing.ending_s
        while time.monotonic() < deadline and not self._failsafe_message:
            memory.heartbeat("supervisor", time.monotonic_ns())
            if memory.stage("control") in (Stage.DONE, Stage.FAILED) or memory.watchdog_trip_ns:
                return
            if self._gone("control") and self._gone("watchdog"):
                break
            time.sleep(0.001)
        if self._failsafe_message or memory.safe_ns:
            return
        trouble = force_safe_state(self.plan.config, memory)
        self._failsafe_message = "neither control nor the watchdog acts: the supervisor has written the safe state"
        if trouble:
            self._failsafe_message = f"neither control nor the watchdog acts, and the supervisor failed: {trouble}"

    def _unsafe(self) -> str:
        """Why no process has written the safe state; empty if one has."""
        self._judged = True
        if not self.memory.safe_ns:
            # The watchdog publishes at its end whether its last write has succeeded.
            ended_within(self.children["watchdog"], self.timing.ending_s)
        if self._written():
            off = unsafe_output(self.plan.config)
            if not off:
                return ""
            if trouble := force_safe_state(self.plan.config, self.memory):
                return f"{UNSAFE}: {off}, though it had been made safe; {trouble}"
            self._failsafe_message = (
                f"{off}, though it had been made safe: the supervisor has written the safe state once more"
            )
            return ""
        if not self._failsafe_message and not force_safe_state(self.plan.config, self.memory):
            self._failsafe_message = (
                "neither control nor the watchdog could write the safe state: the supervisor has written it"
            )
            return ""
        message = self.memory.message("watchdog")
        return message if UNSAFE in message else f"{UNSAFE}: neither control nor the watchdog has reported that it was"

    def _written(self) -> bool:
        """True if a process has written the safe state and nothing was written after it."""
        return bool(self.memory.safe_ns) or self.memory.stage("watchdog") is Stage.DONE

    def _gone(self, name: str) -> bool:
        """True if a process has died or has no recent heartbeat."""
        return (
            self.monitors[name].exited
            or time.monotonic_ns() - self.memory.heartbeat_ns(name) > self.timing.failsafe_silent_ns
        )

    def _spawn(self, name: str, module: str) -> None:
        process = spawn(module, ChildJob(self.plan, self.memory.fd, os.getpid()))
        self.children[name], self.monitors[name] = process, ProcessMonitor(process.pid)
        if name == "control":
            self.memory.control_pid = process.pid
        elif name == "watchdog":
            self.memory.watchdog_pid = process.pid

    def _ready(self, name: str) -> bool:
        if name == "simulator":
            return self.plant is None or self.plant.ready()
        return self.memory.stage(name) is not Stage.STARTING

    def _await(self, name: str) -> None:
        """Wait until a starting process is ready; a fault of any of them ends the run before it begins."""
        started = time.monotonic()
        reported = False
        while not self._ready(name):
            self.memory.heartbeat("supervisor", time.monotonic_ns())
            self._check_start()
            waited = time.monotonic() - started
            if waited > SLOW_START_S and not reported:
                reported = True
                stopped = name in self.monitors and self.monitors[name].stopped
                why = "it was stopped" if stopped else "after a new version it compiles its kernels once"
                message = f"waiting for the {name} process: {why}"
                self.operator.report(Event(time.monotonic_ns(), Level.INFO, "supervisor", message))
            if waited > START_TIMEOUT_S:
                raise StartError(f"the {name} process was not ready within {START_TIMEOUT_S:.0f} s")
            self._serve(START_LOOK_S)
        self._check_start()

    def _check_start(self) -> None:
        """Raise if the run must not begin: a stop was requested, or a starting process has failed."""
        reason = self.operator.stop_requested() or (self.command_handler.ending and self.command_handler.ending[1])
        if reason:
            raise StoppedError(f"stopped before the run began: {reason}")
        if fault := self._lost():
            name, message = fault
            status = self._exit_status(name) if self._died(name) else ""
            raise StartError(message.replace("process died", "process died while it started") + status)
        if (stop := self.memory.stop_request) != Stop.NONE:
            raise StartError(f"before the run began, {STOPPED[stop]}")

    def _event(self, level: Level, source: str, message: str) -> None:
        self._report(Event(time.monotonic_ns(), level, source, message))

    def _report(self, *events: Event) -> None:
        for event in events:
            self.recorder.event(event)
            self.memory.push_event(event)
            self.operator.report(event)
