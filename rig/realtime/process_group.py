"""The child processes of a run as one group: start, faults, end."""

from __future__ import annotations

import contextlib
import os
import subprocess
import time
from collections.abc import Iterable
from typing import NamedTuple

from rig.execution.plan import RunPlan
from rig.hardware import running
from rig.realtime.child_process import ChildJob, ended_within, spawn
from rig.realtime.process_monitor import ProcessMonitor
from rig.realtime.scheduling import HeartbeatMonitor, set_niceness
from rig.realtime.shared_state import TIP_CONTROLLER, SharedState, Stage
from rig.realtime.timing_limits import TimingLimits
from rig.simulator.plant_launcher import PlantProcess

PROCESSES = ("watchdog", "control", "observer")
"""The processes without which a run ends, in the order of their start."""
WATCHDOG_TRIPPED = "the watchdog took the bench over, and exited before it could report why"
EXIT_STATUS_S = 1.0
"""Time for an exiting process to release its memory: its exit status is known only then."""
LATE_NS = 200_000_000
STOPPED_S = 5.0
"""A process that a signal has stopped is a fault after this silence, however long a busy machine may delay it."""


class ProcessFault(NamedTuple):
    """A process with a fault, and the message; `died`: it has exited without one."""

    source: str
    message: str
    died: bool = False


class ProcessGroup:
    """The processes of one run; a tip controller and a simulated plant if it has them."""

    def __init__(self, plan: RunPlan, memory: SharedState, plant: PlantProcess | None, period_s: float) -> None:
        """`period_s` is the period at which `fault` is called."""
        self._plan, self._memory, self._plant = plan, memory, plant
        self._children: dict[str, subprocess.Popen[bytes]] = {}
        self._monitors: dict[str, ProcessMonitor] = {}
        # After a stall of the whole machine every process gets time to send a heartbeat.
        self._heartbeats = {name: HeartbeatMonitor(round(period_s * 1e9), LATE_NS) for name in PROCESSES}

    def start(self, name: str) -> None:
        """Start one of PROCESSES, or TIP_CONTROLLER, and monitor it."""
        job = ChildJob(self._plan, self._memory.fd, os.getpid())
        self.add(name, spawn(f"rig.realtime.{name}_process", job))

    def add(self, name: str, process: subprocess.Popen[bytes]) -> None:
        """Monitor a started process."""
        self._children[name], self._monitors[name] = process, ProcessMonitor(process.pid)
        if name == "control":
            self._memory.control_pid = process.pid
        elif name == "watchdog":
            self._memory.watchdog_pid = process.pid
        if name in ("control", "watchdog"):
            running.listens(process.pid)

    def ready(self, name: str) -> bool:
        """True once a process, or the "simulator", has completed its start."""
        if name == "simulator":
            return self._plant is None or self._plant.ready()
        return self._memory.stage(name) is not Stage.STARTING

    def set_niceness(self, name: str, niceness: int) -> int | None:
        """Request a niceness for a process; return the one that it has, None once it has exited."""
        with contextlib.suppress(ProcessLookupError):
            return set_niceness(self._children[name].pid, niceness)
        return None

    def stopped(self, name: str) -> bool:
        """True while a process is stopped by a signal or a debugger."""
        return name in self._monitors and self._monitors[name].stopped

    def silent(self, name: str, limit_ns: int) -> bool:
        """True if a process has exited or sent its last heartbeat more than `limit_ns` ago."""
        return self._monitors[name].exited or time.monotonic_ns() - self._memory.heartbeat_ns(name) > limit_ns

    def await_exit(self, name: str, timeout_s: float) -> bool:
        """Wait for the exit of a process; True once it has exited."""
        return ended_within(self._children[name], timeout_s)

    def failure(self, names: Iterable[str] = (*PROCESSES, TIP_CONTROLLER)) -> ProcessFault | None:
        """The first of the started processes `names` that has failed or died; None if there is none."""
        for name in names:
            if name not in self._monitors:
                continue
            exited, stage = self._monitors[name].exited, self._memory.stage(name)
            if stage is Stage.FAILED:
                return ProcessFault(name, self._memory.message(name))
            if exited and stage is not Stage.DONE:
                return ProcessFault(name, f"the {name} process died", died=True)
        return None

    def explained(self, fault: ProcessFault) -> str:
        """The message of a fault, with the exit status of a process that has died if it is known."""
        if fault.died and self.await_exit(fault.source, EXIT_STATUS_S):
            return f"{fault.message} (exit status {self._children[fault.source].returncode})"
        return fault.message

    def fault(self, timing: TimingLimits) -> ProcessFault | None:
        """A process of a running experiment that has failed, died or been silent for too long, else None."""
        memory = self._memory
        if memory.watchdog_trip_ns:
            return ProcessFault("watchdog", WATCHDOG_TRIPPED)
        if failure := self.failure(PROCESSES):
            return failure
        if self._plant is not None and self._plant.exit_status is not None:
            return ProcessFault("simulator", f"the simulator died (exit status {self._plant.exit_status})")
        now = time.monotonic_ns()
        limits_s = {
            "observer": timing.supervised_observer_s,
            "control": timing.supervised_control_s,
            "watchdog": timing.supervised_watchdog_s,
        }
        silent_s = {name: self._heartbeats[name].silent_ns(now, memory.heartbeat_ns(name)) * 1e-9 for name in limits_s}
        ended = memory.stage("control") in (Stage.DONE, Stage.FAILED)
        for name in ("observer",) if ended else limits_s:
            if silent_s[name] > STOPPED_S and self.stopped(name):
                since = f"has been stopped for {silent_s[name]:.1f} s, by a signal (SIGSTOP) or a debugger"
                return ProcessFault(name, f"the {name} process {since}")
            if silent_s[name] > limits_s[name]:
                return ProcessFault(name, f"the {name} process has been silent for {silent_s[name]:.1f} s")
        if self._plant is not None and timing.simulator_ns is not None and not ended:
            late_ns = self._plant.late_ns(now)
            if late_ns > timing.simulator_ns:
                return ProcessFault("simulator", f"the simulator has stalled for {late_ns * 1e-9:.1f} s")
        return None

    def completed(self, fault: ProcessFault, timing: TimingLimits) -> ProcessFault:
        """The fault with what is known once the valves are safe: exit status, or the reason of the watchdog."""
        if self._memory.watchdog_trip_ns:
            # The reason of the watchdog comes first: other faults may follow from it. It is published at its end.
            self.await_exit("watchdog", timing.ending_s)
            return ProcessFault("watchdog", self._memory.message("watchdog") or fault.message)
        return fault._replace(message=self.explained(fault))

    def end(self, timeout_s: float) -> set[str]:
        """Wait until every process has exited, the watchdog last; kill those that do not. Returns the killed ones.

        The processes must have been requested to stop. Those that have not opened a device yet are killed at once.
        """
        if self._memory.simulator_starting:
            # While they load they do not check for a stop request.
            for process in self._children.values():
                process.kill()
        if TIP_CONTROLLER in self._children:
            self._children[TIP_CONTROLLER].kill()  # it holds no device, and its plans are recorded
        killed = set()
        # The watchdog ends last: it writes the safe state when the others cannot.
        for name, process in sorted(self._children.items(), key=lambda member: member[0] == "watchdog"):
            # A stopped observer ends no sooner: it drives nothing.
            patience_s = 0.0 if name == "observer" and self.stopped(name) else timeout_s
            if not ended_within(process, patience_s):
                process.kill()
                # A time-out, because the exit of a traced process is hidden until its debugger collects it.
                ended_within(process, EXIT_STATUS_S)
                killed.add(name)
        for monitor in self._monitors.values():
            monitor.close()
        return killed
