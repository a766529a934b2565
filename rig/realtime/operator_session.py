"""The operator during a run: terminal, control socket, commands and prompts."""

from __future__ import annotations

import time
from collections.abc import Callable

from rig.execution.plan import OperatorInterface, RunPlan
from rig.realtime.control_socket import ControlSocket
from rig.realtime.data_recorder import DataRecorder
from rig.realtime.operator_commands import CommandKind, CommandResult, OperatorCommand, user_name
from rig.realtime.outcome import Ending
from rig.realtime.shared_state import SharedState, Stop
from rig.realtime.stream_receiver import StreamReceiver
from runs.records import Level, Status

SHOW_S = 0.1


class OperatorSession:
    """Takes commands from the terminal and from attached pages, and shows the progress of the run."""

    def __init__(
        self, plan: RunPlan, memory: SharedState, operator: OperatorInterface, event: Callable[[Level, str, str], None]
    ) -> None:
        """`event` records an event; it is called only after the run has begun."""
        self._plan, self._memory, self._operator, self._event = plan, memory, operator, event
        self.stream = StreamReceiver(plan, memory, event)
        self._socket: ControlSocket | None = None
        self._shown = 0.0
        self._shown_prompt = -1
        self.ending: Ending | None = None
        """Status and reason with which a command ends the run; None while it continues."""

    def open(self) -> str:
        """Open the control socket; return why pages cannot attach, else empty."""
        try:
            self._socket = ControlSocket(self._plan, self._memory, self.stream)
        except OSError as error:
            return f"no page can watch this run: {error}"
        return ""

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()

    def serve(self, timeout_s: float) -> None:
        """Answer attached pages for `timeout_s`."""
        if self._socket is None:
            time.sleep(timeout_s)
        else:
            self._socket.serve(timeout_s, self.handle)

    def end_requested(self) -> Ending | None:
        """Read the terminal; return the status and reason with which the operator ends the run, else None."""
        if reason := self._operator.stop_requested():
            return Ending(Status.INTERRUPTED, reason)
        if self._operator.pause_toggled():
            self._command_of_terminal(CommandKind.RESUME if self._memory.paused else CommandKind.PAUSE)
        return self.ending

    def start_cancelled(self) -> str:
        """Why the operator wants no run, before it has begun; else empty."""
        return self._operator.stop_requested() or (self.ending.message if self.ending else "")

    def update(self, record: DataRecorder) -> None:
        """Handle the prompt of the protocol, and show the progress every SHOW_S."""
        waiting, now = self._memory.waiting_prompt, time.monotonic()
        new_prompt = waiting >= 0 and waiting != self._shown_prompt
        if new_prompt:
            self._shown_prompt = waiting
            self._event(Level.INFO, "protocol", f"waiting for the operator: {self._prompt_text(waiting)}")
        elif waiting >= 0 and self._memory.prompts_answered <= waiting and self._operator.answered():
            self._command_of_terminal(CommandKind.ANSWER)
        if self._socket is not None:
            self.stream.update(str(self._socket.path))
        if new_prompt or now - self._shown > SHOW_S:
            self._shown = now
            self._operator.show(record.progress())

    def _command_of_terminal(self, kind: CommandKind) -> None:
        self.handle(OperatorCommand(kind, f"{user_name()} (terminal)"))

    def handle(self, command: OperatorCommand) -> CommandResult:
        """Execute a command and record it: set the flags that control reads in its next cycle."""
        if not self._memory.start_ns and command.action not in (CommandKind.STOP, CommandKind.VENT):
            return CommandResult(False, "the run has not begun")
        answer = self._executed(command.action, command.who)
        if answer.accepted and self._memory.start_ns:
            self._event(Level.INFO, "operator", answer.message)
        return answer

    def _executed(self, action: CommandKind, who: str) -> CommandResult:
        memory, at_s = self._memory, self._memory.protocol_s
        match action:
            case CommandKind.VENT | CommandKind.STOP:
                vents = action is CommandKind.VENT
                memory.request_stop(Stop.VENT if vents else Stop.SAFE)
                sentence = f"{'vented' if vents else 'stopped'} by {who}"
                self.ending = self.ending or Ending(Status.INTERRUPTED, sentence)
                return CommandResult(True, sentence)
            case CommandKind.PAUSE | CommandKind.RESUME:
                paused = action is CommandKind.PAUSE
                if memory.paused == paused:
                    return CommandResult(False, "the run is paused already" if paused else "the run is not paused")
                memory.paused = paused
                done = "paused" if paused else "resumed"
                return CommandResult(True, f"{done} by {who} at protocol time {at_s:.2f} s")
            case CommandKind.SKIP:
                if memory.paused:
                    return CommandResult(False, "the run is paused and holds its pressures; resume it, then skip")
                memory.skips = memory.skips + 1
                segment = self._plan.trajectory.segment_at(at_s)
                name = segment.label or segment.kind
                return CommandResult(True, f"rest of '{name}' skipped by {who} at protocol time {at_s:.2f} s")
            case CommandKind.ANSWER:
                waiting = memory.waiting_prompt
                if waiting < 0 or memory.prompts_answered > waiting:
                    return CommandResult(False, "no prompt waits for an answer")
                memory.prompts_answered = waiting + 1
                return CommandResult(True, f"done, says {who}: {self._prompt_text(waiting)}")

    def _prompt_text(self, index: int) -> str:
        return self._plan.trajectory.prompts[index].message
