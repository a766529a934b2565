"""The end of a run: waits for the safe state, verifies it, writes it if no other process can, and has it confirmed."""

from __future__ import annotations

import time

from rig.config.schema import RigConfig
from rig.hardware.call_limit import LONGEST_CALL_S, within
from rig.hardware.cards.base import CardError
from rig.hardware.safe_state import UNSAFE, unsafe_output
from rig.hardware.vent_verification import LONGEST_VENTING_S, UNCONFIRMED, VentOutcome, verify_venting
from rig.realtime.failsafe import force_safe_state
from rig.realtime.process_group import ProcessGroup
from rig.realtime.shared_state import SharedState, Stage, Stop
from rig.realtime.timing_limits import TimingLimits

POLL_S = 0.001


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

    def make_safe(self, timing: TimingLimits) -> None:
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
            time.sleep(POLL_S)
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
                off = within(lambda: unsafe_output(self._config), alive=self._alive)
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
