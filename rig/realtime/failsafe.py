"""The failsafe of last resort: writes the safe state when neither control nor the watchdog can."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time

from rig.config.schema import RigConfig
from rig.hardware.call_limit import within
from rig.hardware.cards.base import CardError, card_type
from rig.hardware.safe_state import failure_of, make_safe
from rig.hardware.vent_verification import verify_venting
from rig.realtime.child_process import ChildJob, report_end, supervisor_monitor
from rig.realtime.process_monitor import ProcessMonitor
from rig.realtime.shared_state import SharedState, Stage, Stop
from rig.realtime.timing_limits import timing_limits

POLL_S = 0.02
RELEASE_S = 0.5


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


def force_safe_state(config: RigConfig, memory: SharedState) -> str:
    """Write the safe state, kill control and the watchdog, which may only be suspended, and write it again.

    Returns why it could not be written; empty on success. A driver that never returns is a failure, too.
    """

    def write() -> None:
        within(lambda: make_safe(config, vent=memory.vents))

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
    memory.safe_ns = 0 if failure else time.monotonic_ns()
    return failure
