"""The conductor of a real-time run: starts the processes, records what they write, and ends the run in order."""

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
from rig.hardware.bench import UNSAFE, unsafe_output
from rig.hardware.cards.base import CardError
from rig.hardware.cards.registry import card_type
from rig.realtime import sampling_clocks
from rig.realtime.child_process import ChildJob, ended_within, spawn
from rig.realtime.control_socket import ControlSocket
from rig.realtime.failsafe import force_safe_state
from rig.realtime.health_monitor import HealthMonitor
from rig.realtime.operator_commands import Command, CommandHandler, CommandResult, OperatorCommand, user_name
from rig.realtime.process_monitor import ProcessMonitor
from rig.realtime.scheduling import REAL_TIME, HeartbeatMonitor, Scheduling, obtainable, stolen_ms
from rig.realtime.shared_state import SharedState, Stage, StateLayout, Stop
from rig.realtime.timing_limits import Profile, remedies, stated, timing_limits
from rig.simulator.plant_launcher import Simulation, started
from runs.records import Event, Level, Status

SLOW_START_S = 4.0
START_TIMEOUT_S = 300.0
"""Generous: a cold compiler cache or a busy machine is not a fault."""
LEAD_NS = 60_000_000
START_LOOK_S = 0.005
DRAIN_S = 0.02
SHOW_S = 0.1
LAST_FRAME_S = 0.5
STATUS_S = 1.0
"""What a process that dies gets to give its memory back: only then its exit status is known."""
OVERSLEPT_NS = 200_000_000
TAKEN_OVER = "the watchdog took the bench over, and was itself gone before it could say why"

STOPPED = {
    Stop.SAFE: "the run was told to stop",
    Stop.SILENT: "the conductor had been silent, and the others were told to make the bench safe",
    Stop.TERMINATED: "the control process was told to terminate",
    Stop.VENT: "the run was told to vent",
}


def run(plan: Plan, open_record: OpenRecord, audience: OperatorInterface) -> Outcome:
    """Run one plan in real time; return once the valves are safe and every process has ended.

    Raises:
        CardError, StartError: a device or a process did not come up.
    """
    expected = obtainable()
    waits_ns = timing_limits(plan.config, expected).simulation_waits_ns
    with started(plan.config, plan.rig_file, plan.seed, waits_ns) as plant:
        conductor = _Supervisor(plan, audience, plant, expected)
        try:
            outcome = conductor.run(open_record)
        except BaseException as error:
            trouble = conductor.end() or conductor.complaint
            if trouble and trouble not in str(error) and isinstance(error, Exception):
                raise CardError(f"{error}; {trouble}") from error
            raise
        if trouble := conductor.end():
            said = f"{outcome.message}; {trouble}".removeprefix("; ")
            return replace(outcome, status=Status.ABORTED, message=said)
        return outcome


class _Supervisor:
    def __init__(
        self, plan: Plan, audience: OperatorInterface, plant: Simulation | None, expected: Scheduling = Scheduling.NONE
    ) -> None:
        self.plan = plan
        self.plant = plant
        self.timing = timing_limits(plan.config, expected)
        self.recorder: Recorder
        self.audience = audience
        self.memory = SharedState.create(StateLayout.of(plan.config, len(plan.adapted)))
        self.desk = CommandHandler(self.memory, plan.trajectory)
        self.door: ControlSocket | None = None
        self.crew: dict[str, subprocess.Popen[bytes]] = {}
        self.lives: dict[str, ProcessMonitor] = {}
        self._stood_in = ""
        self._judged = False
        self.vigil = HealthMonitor(plan.config)
        self.lost_scans = 0
        # What stood still while this process did gets the time to give a sign of life.
        self.silences = {
            name: HeartbeatMonitor(round(DRAIN_S * 1e9), OVERSLEPT_NS) for name in ("observer", "control", "watchdog")
        }
        self.missed = 0
        self.dropped = 0
        self._sample: NDArray[np.void] | None = None
        self._observation: NDArray[np.void] | None = None
        self._adaptation: NDArray[np.void] | None = None
        self._shown_prompt = -1

    def run(self, open_record: OpenRecord) -> Outcome:
        """Start, conduct, end."""
        memory = self.memory
        trouble = self._open_door()
        memory.beat("conductor", time.monotonic_ns())
        memory.set("plant_starting", self.plant is not None)
        for name in ("watchdog", "control", "observer"):
            self._spawn(name, f"rig.realtime.{name}_process")
        for card in self.plan.config.cards.values():
            card_type(card)  # no time to load it when it is needed
        self._await("simulator")
        memory.set("plant_starting", False)
        for name in self.crew:
            self._await(name)
        self.timing = timing_limits(self.plan.config, memory.granted)
        stolen = stolen_ms()
        go = time.monotonic_ns() + LEAD_NS
        self.recorder = open_record(go)
        self._event(Level.INFO, "control", "armed: the safe state was written and read back")
        for sentence in sampling_clocks.descriptions(memory, self.plan.config):
            self._event(Level.INFO, "card", sentence)
        self._tell_timing()
        if trouble:
            self._event(Level.WARNING, "conductor", trouble)
        memory.beat("conductor", time.monotonic_ns())
        memory.set("go_ns", max(go, time.monotonic_ns() + LEAD_NS // 10))
        try:
            status, message = self._conduct()
        finally:
            self._make_safe()
        # The last frame is still being looked at; what a page has shown is to be in the record.
        ended_within(self.crew["observer"], LAST_FRAME_S)
        self._drain()
        # Also where another fault has ended the run: air that does not go is to be told of.
        if self.complaint not in message:
            status, message = Status.ABORTED, f"{message}; {self.complaint}".removeprefix("; ")
            self._event(Level.FAULT, "control", self.complaint)
        if memory.get("fired_ns") and status is not Status.ABORTED:
            status, message = Status.ABORTED, memory.message("watchdog") or TAKEN_OVER
        safe_ns = memory.get("safe_ns") or memory.get("fired_ns")
        trouble = self._unsafe()
        if self._stood_in:
            self._event(Level.FAULT, "conductor", self._stood_in)
        if trouble:
            status = Status.ABORTED
            message = message if UNSAFE in message else f"{message}; {trouble}".removeprefix("; ")
            self._event(Level.FAULT, "watchdog", trouble)
        else:
            writer = "conductor" if self._stood_in else "control" if memory.get("safe_ns") else "watchdog"
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
        memory.say("conductor", Stage.DONE, f"{status}: {message}".removesuffix(": "))
        return Outcome(status, message, safe_ns or time.monotonic_ns(), counters)

    def _tell_timing(self) -> None:
        """Record what scheduling was granted and what counts as hung under it."""
        granted = self.memory.granted
        if refused := remedies(granted):
            self._event(Level.WARNING, "control", refused)
        level = Level.WARNING if self.timing.profile is Profile.ORDINARY else Level.INFO
        if self.timing.profile is not Profile.STRICT or REAL_TIME not in granted:
            self._event(level, "supervisor", stated(self.plan.config, granted))

    @property
    def complaint(self) -> str:
        """What control has failed by: air that does not go is to be told of, whatever else ends a run."""
        return self.memory.message("control") if self.memory.stage("control") is Stage.FAILED else ""

    def end(self) -> str:
        """Leave no process behind; may be called at any time. Returns what is wrong with the valves then."""
        memory = self.memory
        memory.ask_to_stop(Stop.SAFE)
        if self.door is not None:
            self.door.close()
        if memory.get("plant_starting"):
            # Nobody has had his turn: they only load, and would look up when they are done.
            for process in self.crew.values():
                process.kill()
        said = ""
        # The watchdog goes last: it is the one that writes the safe state when the others cannot.
        for name, process in sorted(self.crew.items(), key=lambda member: member[0] == "watchdog"):
            if not ended_within(process, self.timing.ending_s):
                process.kill()
                # Not for ever: the end of a process that a debugger holds is hidden until the debugger asks for it.
                ended_within(process, STATUS_S)
                if name == "watchdog":
                    said = "the watchdog did not end; check the valves and run `rig vent --rig` with this rig"
        for life in self.lives.values():
            life.close()
        # Control gives a sign of life before it touches a card; before that nobody has moved a valve.
        if not self._judged and memory.heartbeat_ns("control") and not self._written():
            trouble = force_safe_state(self.plan.config, memory)
            return trouble if not trouble or UNSAFE in trouble else f"{UNSAFE}: {trouble}"
        return said

    def _conduct(self) -> tuple[Status, str]:
        memory = self.memory
        shown = 0.0
        while True:
            memory.beat("conductor", time.monotonic_ns())
            # Before it is looked at why: who stands still in between finds control done, and no reason.
            done = memory.stage("control") == Stage.DONE
            self._report(*self.vigil.looking(time.monotonic_ns()))
            self._drain()
            self._report(*self.vigil.disk(time.monotonic_ns(), self.recorder.stalled_s))
            if reason := self.audience.stop_requested():
                return Status.INTERRUPTED, reason
            if self.audience.pause_toggled():
                wish = Command.RESUME if memory.get("held") else Command.PAUSE
                self._carry_out(OperatorCommand(wish, f"{user_name()} (terminal)"))
            if self.desk.ending is not None:
                return self.desk.ending
            if (stop := Stop(memory.get("stop"))) != Stop.NONE:
                self._event(Level.FAULT, "conductor", STOPPED[stop])
                return Status.ABORTED, STOPPED[stop]
            if fault := self._fault():
                # Who is silent is killed where he does not act: that is no news of what befell him.
                died = self._died(fault[0])
                # First of all: a process that is long in dying is not to be waited for.
                self._make_safe()
                fault = self._explained(*fault, died=died)
                self._event(Level.FAULT, *fault)
                return Status.ABORTED, fault[1]
            if done:
                return Status.FINISHED, ""
            self._prompt()
            if self.plant is not None:
                self.plant.hang(self.plan.trajectory.weight_kg(float(memory.board["protocol_s"][0])))
            if (now := time.monotonic()) - shown > SHOW_S:
                shown = now
                self.audience.show(self._progress())
            self._attend(DRAIN_S)

    def _open_door(self) -> str:
        """Let pages attach to this run; what keeps them out, empty when nothing does."""
        try:
            self.door = ControlSocket(self.plan, self.memory)
        except OSError as error:
            return f"no page can watch this run: {error}"
        return ""

    def _attend(self, timeout_s: float) -> None:
        if self.door is None:
            time.sleep(timeout_s)
        else:
            self.door.attend(timeout_s, self._carry_out)

    def _carry_out(self, request: OperatorCommand) -> CommandResult:
        """Do what an operator asks for, then record it."""
        if not self.memory.get("go_ns") and request.action not in (Command.STOP, Command.VENT):
            return CommandResult(False, "the run has not begun")
        answer = self.desk.carry_out(request)
        if answer.done and self.memory.get("go_ns"):
            self._event(Level.INFO, "operator", answer.said)
        return answer

    def _fault(self) -> tuple[str, str] | None:
        """Which process has a fault, and what it is."""
        memory = self.memory
        if memory.get("fired_ns"):
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
        silent_s = {name: self.silences[name].look(now, memory.heartbeat_ns(name)) * 1e-9 for name in patience_s}
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
        """Which process has failed or died."""
        for name, life in self.lives.items():
            over, stage = life.over, self.memory.stage(name)
            if stage is Stage.FAILED:
                return name, self.memory.message(name)
            if over and stage is not Stage.DONE:
                return name, f"the {name} process died"
        return None

    def _explained(self, source: str, message: str, *, died: bool) -> tuple[str, str]:
        """A fault with what is known of it once the valves are safe."""
        if self.memory.get("fired_ns"):
            # What the watchdog saw comes first: what others complain of may follow from it. It explains at its end.
            ended_within(self.crew["watchdog"], self.timing.ending_s)
            return "watchdog", self.memory.message("watchdog") or message
        return source, message + (self._exit_status(source) if died else "")

    def _died(self, name: str) -> bool:
        """True for a process that has died without a word."""
        return name in self.lives and self.lives[name].over and self.memory.stage(name) <= Stage.RUNNING

    def _exit_status(self, name: str) -> str:
        """That of a process that has died."""
        return f" (exit status {self.crew[name].returncode})" if ended_within(self.crew[name], STATUS_S) else ""

    def _drain(self) -> None:
        """Move everything that the processes have written into the record."""
        samples = self.memory.samples.read()
        if len(samples):
            self.recorder.samples(samples)
            self.missed += int(samples["missed"].sum())
            self._sample = samples[-1]
            self._report(*self.vigil.samples(samples))
        lost, self.lost_scans = self.memory.get("lost_scans") - self.lost_scans, self.memory.get("lost_scans")
        self._report(*self.vigil.lost(time.monotonic_ns(), lost))
        observations = self.memory.observations.read()
        if len(observations):
            self.recorder.observations(observations)
            self.dropped += int(observations["dropped"].sum())
            self._observation = observations[-1]
            self._report(*self.vigil.observations(observations))
        adaptations = self.memory.adaptations.read()
        if len(adaptations):
            self.recorder.adaptations(adaptations)
            self._adaptation = adaptations[-1]
        for picture in self.memory.read_pictures(list(self.plan.config.cameras), self.plan.config.recording.encoding):
            self.recorder.picture(picture)

    def _prompt(self) -> None:
        waiting = self.memory.get("waiting")
        if waiting < 0:
            return
        if waiting != self._shown_prompt:
            self._shown_prompt = waiting
            self._event(Level.INFO, "protocol", f"waiting for the operator: {self._prompt_text(waiting)}")
            self.audience.show(self._progress())
        elif self.memory.get("answered") <= waiting and self.audience.answered():
            self.memory.set("answered", waiting + 1)
            self._event(Level.INFO, "operator", f"done: {self._prompt_text(waiting)}")

    def _prompt_text(self, index: int) -> str:
        return self.plan.trajectory.prompts[index].message

    def _progress(self) -> Progress:
        waiting = self.memory.get("waiting")
        return Progress(
            protocol_s=float(self.memory.board["protocol_s"][0]),
            duration_s=self.plan.trajectory.duration_s,
            sample=self._sample,
            observation=self._observation,
            missed=self.missed,
            prompt=self._prompt_text(waiting) if waiting >= 0 else None,
            held=bool(self.memory.get("held")),
            adapted=self.plan.adapted,
            adaptation=self._adaptation,
        )

    def _make_safe(self) -> None:
        """Ask control for the safe state and wait until it, or who stands in for it, has written it; once is enough."""
        memory = self.memory
        memory.ask_to_stop(Stop.SAFE)
        deadline = time.monotonic() + self.timing.ending_s
        while time.monotonic() < deadline and not self._stood_in:
            memory.beat("conductor", time.monotonic_ns())
            if memory.stage("control") in (Stage.DONE, Stage.FAILED) or memory.get("fired_ns"):
                return
            if self._gone("control") and self._gone("watchdog"):
                break
            time.sleep(0.001)
        if self._stood_in or memory.get("safe_ns"):
            return
        trouble = force_safe_state(self.plan.config, memory)
        self._stood_in = "neither control nor the watchdog acts: the conductor has written the safe state"
        if trouble:
            self._stood_in = f"neither control nor the watchdog acts, and the conductor failed: {trouble}"

    def _unsafe(self) -> str:
        """What kept everybody from writing the safe state; empty when somebody has."""
        self._judged = True
        if not self.memory.get("safe_ns"):
            # It says at its very end whether its last write has succeeded.
            ended_within(self.crew["watchdog"], self.timing.ending_s)
        if self._written():
            off = unsafe_output(self.plan.config)
            if not off:
                return ""
            if trouble := force_safe_state(self.plan.config, self.memory):
                return f"{UNSAFE}: {off}, though it had been made safe; {trouble}"
            self._stood_in = f"{off}, though it had been made safe: the conductor has written the safe state once more"
            return ""
        if not self._stood_in and not force_safe_state(self.plan.config, self.memory):
            self._stood_in = "neither control nor the watchdog could write the safe state: the conductor has written it"
            return ""
        said = self.memory.message("watchdog")
        return said if UNSAFE in said else f"{UNSAFE}: neither control nor the watchdog has said that it was"

    def _written(self) -> bool:
        """True where somebody has written the safe state, and nothing was written after it."""
        return bool(self.memory.get("safe_ns")) or self.memory.stage("watchdog") is Stage.DONE

    def _gone(self, name: str) -> bool:
        """True when a process has died or gives no sign of life."""
        return (
            self.lives[name].over
            or time.monotonic_ns() - self.memory.heartbeat_ns(name) > self.timing.failsafe_silent_ns
        )

    def _spawn(self, name: str, module: str) -> None:
        process = spawn(module, ChildJob(self.plan, self.memory.fd, os.getpid()))
        self.crew[name], self.lives[name] = process, ProcessMonitor(process.pid)
        if name != "observer":
            self.memory.set(f"{name}_pid", process.pid)

    def _ready(self, name: str) -> bool:
        if name == "simulator":
            return self.plant is None or self.plant.ready()
        return self.memory.stage(name) is not Stage.STARTING

    def _await(self, name: str) -> None:
        """Wait for one of those that start; whatever befalls any of them meanwhile ends the run before it begins."""
        started = time.monotonic()
        told = False
        while not self._ready(name):
            self.memory.beat("conductor", time.monotonic_ns())
            self._refuse()
            waited = time.monotonic() - started
            if waited > SLOW_START_S and not told:
                told = True
                still = name in self.lives and self.lives[name].stopped
                why = "it was stopped" if still else "after a new version it compiles its kernels once"
                message = f"waiting for the {name} process: {why}"
                self.audience.tell(Event(time.monotonic_ns(), Level.INFO, "conductor", message))
            if waited > START_TIMEOUT_S:
                raise StartError(f"the {name} process was not ready within {START_TIMEOUT_S:.0f} s")
            self._attend(START_LOOK_S)
        self._refuse()

    def _refuse(self) -> None:
        """Raise where the run must not begin: somebody wants it to end, or one of those that start is lost."""
        reason = self.audience.stop_requested() or (self.desk.ending and self.desk.ending[1])
        if reason:
            raise StoppedError(f"stopped before the run began: {reason}")
        if fault := self._lost():
            name, said = fault
            status = self._exit_status(name) if self._died(name) else ""
            raise StartError(said.replace("process died", "process died while it started") + status)
        if (stop := Stop(self.memory.get("stop"))) != Stop.NONE:
            raise StartError(f"before the run began, {STOPPED[stop]}")

    def _event(self, level: Level, source: str, message: str) -> None:
        self._report(Event(time.monotonic_ns(), level, source, message))

    def _report(self, *events: Event) -> None:
        for event in events:
            self.recorder.event(event)
            self.memory.push_event(event)
            self.audience.tell(event)
