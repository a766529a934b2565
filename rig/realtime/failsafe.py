"""The writers of last resort, where neither control nor the watchdog makes the valves safe; the end of a run.

The supervisor is the first of them, a thread of the observer the second.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from typing import TYPE_CHECKING

from rig.config.schema import RigConfig
from rig.hardware.call_limit import LONGEST_CALL_S, within
from rig.hardware.cards.base import CardError, card_type
from rig.hardware.safe_state import UNSAFE, RigSafeState, failure_of
from rig.hardware.vent_verification import LONGEST_VENTING_S, UNCONFIRMED, VentOutcome, verify_venting
from rig.realtime.child_process import ChildJob, report_end, supervisor_monitor
from rig.realtime.process_monitor import ProcessMonitor
from rig.realtime.shared_state import SharedState, Stage, Stop
from rig.realtime.timing_limits import TimingLimits, timing_limits

if TYPE_CHECKING:
    from rig.realtime.process_group import ProcessGroup

POLL_S = 0.02
"""Period of the failsafe thread: short beside the silence after which it acts."""
AWAITED_POLL_S = 0.001
"""Period of the supervisor while it waits for the safe state: the end of a run waits for it."""
RELEASE_S = 0.5
"""How long the kernel may take to release the card of a killed process."""


def force_safe_state(config: RigConfig, memory: SharedState) -> str:
    """Write the safe state, kill control and the watchdog, which may only be suspended, and write it again.

    Returns why it could not be written; empty on success. A driver that never returns is a failure, too.
    """

    def write() -> None:
        within(lambda: RigSafeState(config).make_safe(vent=memory.vents))

    failure_of(write)
    for pid in (memory.control_pid, memory.watchdog_pid):
        if pid:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
    time.sleep(0.005)
    # A card with exclusive access is free only once its process has released its memory; and a killed process may have
    # written once more before it died.
    failure = failure_of(write, RELEASE_S)
    # Set only after the second write: other processes stop checking when it is set.
    if failure:
        memory.safe_ns = 0
    else:
        memory.publish_safe()
    return failure


class FailsafeThread:
    """Thread of the observer that writes the safe state when no other process can.

    A thread, so that neither a late picture nor slow image processing delays it.
    """

    def __init__(self, job: ChildJob, memory: SharedState) -> None:
        self._config, self._memory = job.plan.config, memory
        self._supervisor = supervisor_monitor(job)
        self._monitors: dict[str, ProcessMonitor] = {}
        self._checks = 0
        self._thread = threading.Thread(target=self._watch, name="failsafe", daemon=True)
        self._thread.start()

    def join(self) -> None:
        """Return once the bench is safe, or nothing more can be done."""
        self._thread.join()

    def _watch(self) -> None:
        for card in self._config.cards.values():
            with contextlib.suppress(CardError):
                card_type(card)  # loaded in advance: an emergency leaves no time for imports
        while not self._is_safe():
            if self._is_last():
                self._memory.request_stop(Stop.SILENT)
                failure = force_safe_state(self._config, self._memory)
                if (
                    not failure or self._memory.stage("watchdog") is not Stage.FAILED
                ):  # else the watchdog has reported it
                    report_end(failure, lambda: verify_venting(self._config, vent=self._memory.vents))
                return
            time.sleep(POLL_S)

    def _is_safe(self) -> bool:
        """True once a process has written the safe state, or the supervisor has ended the run."""
        memory = self._memory
        written = memory.safe_ns or memory.watchdog_trip_ns
        # A process that could not write the safe state leaves it to the supervisor, which may die before it writes.
        return bool(written) or Stage.DONE in map(memory.stage, ("control", "watchdog", "supervisor"))

    def _is_last(self) -> bool:
        """True where neither the supervisor nor control nor the watchdog can write the safe state.

        Dead processes count at once. Silent ones count after several consecutive checks: a stall of the whole machine
        makes every process look silent, and those that resume need time to act. Before the start no valve is open.
        """
        memory, now = self._memory, time.monotonic_ns()
        timing = timing_limits(self._config, memory.granted)
        orphaned = self._supervisor.exited
        if orphaned and self._dead("control", memory.control_pid) and self._dead("watchdog", memory.watchdog_pid):
            return True
        silent_ns = min(now - memory.heartbeat_ns(name) for name in ("control", "watchdog"))
        forsaken = orphaned or now - memory.heartbeat_ns("supervisor") > timing.failsafe_supervisor_ns
        alone = memory.start_ns and forsaken and silent_ns > timing.failsafe_silent_ns
        self._checks = self._checks + 1 if alone else 0
        return self._checks > timing.failsafe_checks

    def _dead(self, name: str, pid: int) -> bool:
        """True where a process has died, or a dead supervisor has never started it (`pid` 0)."""
        if pid and name not in self._monitors:
            self._monitors[name] = ProcessMonitor(pid)
        return not pid or self._monitors[name].exited


class Shutdown:
    """The supervisor's part in making the valves safe."""

    def __init__(self, config: RigConfig, memory: SharedState, processes: ProcessGroup) -> None:
        self._config, self._memory, self._processes = config, memory, processes
        self._verified = False
        self.written_message = ""
        """Why the supervisor has written the safe state itself, or has failed to; empty if it did not have to."""

    @property
    def pending(self) -> bool:
        """True if a valve may have moved, no process has written the safe state, and the end was not verified."""
        # Control sends its first heartbeat before it opens a card; before that no valve has moved.
        return not self._verified and bool(self._memory.heartbeat_ns("control")) and not self._written()

    def await_safe_state(self, timing: TimingLimits) -> None:
        """Request the safe state and wait until control or the watchdog has written it; otherwise write it."""
        memory = self._memory
        memory.request_stop(Stop.SAFE)
        deadline = time.monotonic() + timing.ending_s
        while (time.monotonic() < deadline or self._verifying(timing)) and not self.written_message:
            memory.heartbeat("supervisor", time.monotonic_ns())
            if memory.stage("control") in (Stage.DONE, Stage.FAILED) or memory.watchdog_trip_ns:
                return
            if all(self._processes.silent(name, timing.failsafe_silent_ns) for name in ("control", "watchdog")):
                break
            time.sleep(AWAITED_POLL_S)
        if self.written_message or memory.safe_ns:
            return
        failure = force_safe_state(self._config, memory)
        self.written_message = "neither control nor the watchdog acts: the supervisor has written the safe state"
        if failure:
            self.written_message = f"neither control nor the watchdog acts, and the supervisor failed: {failure}"

    def verify(self, timing: TimingLimits) -> str:
        """Why the valves are not safe; empty if a process has written the safe state and it reads back."""
        self._verified = True
        if not self._memory.safe_ns:
            # The watchdog publishes at its end whether its last write has succeeded.
            self._processes.await_exit("watchdog", timing.ending_s)
        if self._written():
            try:
                off = within(lambda: RigSafeState(self._config).departure(), alive=self._alive)
            except CardError as error:
                return f"{UNSAFE}: its outputs cannot be read back: {error}"
            if not off:
                return ""
            if failure := force_safe_state(self._config, self._memory):
                return f"{UNSAFE}: {off}, though it had been made safe; {failure}"
            self.written_message = (
                f"{off}, though it had been made safe: the supervisor has written the safe state once more"
            )
            return ""
        if not self.written_message and not force_safe_state(self._config, self._memory):
            self.written_message = (
                "neither control nor the watchdog could write the safe state: the supervisor has written it"
            )
            return ""
        for name in ("watchdog", "control"):
            if UNSAFE in (message := self._memory.message(name)):
                return message
        why = self.written_message or "neither control nor the watchdog has reported that it was"
        return f"{UNSAFE}: {why}"

    def confirm(self, timing: TimingLimits) -> VentOutcome:
        """Whether the pressures confirm the safe state: by the readings of control, else by this process's own."""
        memory = self._memory
        if memory.confirmation and not (memory.watchdog_trip_ns or self.written_message):
            return VentOutcome(True, memory.confirmation)
        # A card that admits one process at a time, or one command, is free once these have exited.
        for name in ("control", "watchdog"):
            self._processes.await_exit(name, timing.ending_s)
        limit_s = max(timing.vented_s, LONGEST_VENTING_S) + LONGEST_CALL_S
        try:
            return within(
                lambda: verify_venting(self._config, vent=memory.vents, patience_s=timing.vented_s),
                limit_s,
                self._alive,
            )
        except CardError as error:
            return VentOutcome(False, f"{UNCONFIRMED}: {error}", answered=False)

    def unconfirmed(self, timing: TimingLimits) -> str:
        """What the pressures do not confirm of a safe state that was written; empty if they do, or if none was."""
        if not (self._memory.safe_ns or self._memory.watchdog_trip_ns):
            return ""
        vented = self.confirm(timing)
        return "" if vented.confirmed else vented.sentence

    def force(self) -> str:
        """Write the safe state; return why it could not be written, empty on success."""
        failure = force_safe_state(self._config, self._memory)
        return failure if not failure or UNSAFE in failure else f"{UNSAFE}: {failure}"

    def _alive(self) -> None:
        self._memory.heartbeat("supervisor", time.monotonic_ns())

    def _verifying(self, timing: TimingLimits) -> bool:
        """True while control watches the chambers vent, which may take long on a slow bench."""
        return bool(self._memory.safe_ns) and not self._processes.silent("control", timing.failsafe_silent_ns)

    def _written(self) -> bool:
        """True if a process has written the safe state and nothing was written after it."""
        return bool(self._memory.safe_ns) or self._memory.stage("watchdog") is Stage.DONE
