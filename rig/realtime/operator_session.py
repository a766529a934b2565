"""The operator during a run: terminal, control socket, commands and prompts."""

from __future__ import annotations

import time
from collections.abc import Callable

from rig.execution.plan import OperatorInterface, RunPlan
from rig.realtime.control_socket import ControlSocket
from rig.realtime.data_recorder import DataRecorder
from rig.realtime.operator_commands import CommandHandler, CommandKind, CommandResult, OperatorCommand, user_name
from rig.realtime.shared_state import SharedState
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
        self._commands = CommandHandler(memory, plan.trajectory)
        self._stream = StreamReceiver(plan, memory, event)
        self._socket: ControlSocket | None = None
        self._shown = 0.0
        self._shown_prompt = -1

    def open(self) -> str:
        """Open the control socket; return why pages cannot attach, else empty."""
        try:
            self._socket = ControlSocket(self._plan, self._memory, self._stream)
        except OSError as error:
            return f"no page can watch this run: {error}"
        return ""

    @property
    def stream_counts(self) -> dict[str, int]:
        """Lost and refused set-points of other programs; empty for a protocol without a step `stream`."""
        return self._stream.counts if self._plan.trajectory.streams else {}

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()

    def serve(self, timeout_s: float) -> None:
        """Answer attached pages for `timeout_s`."""
        if self._socket is None:
            time.sleep(timeout_s)
        else:
            self._socket.serve(timeout_s, self._handle)

    def end_requested(self) -> tuple[Status, str] | None:
        """Read the terminal; return the status and reason with which the operator ends the run, else None."""
        if reason := self._operator.stop_requested():
            return Status.INTERRUPTED, reason
        if self._operator.pause_toggled():
            kind = CommandKind.RESUME if self._memory.paused else CommandKind.PAUSE
            self._handle(OperatorCommand(kind, f"{user_name()} (terminal)"))
        return self._commands.ending

    def start_cancelled(self) -> str:
        """Why the operator wants no run, before it has begun; else empty."""
        return self._operator.stop_requested() or (self._commands.ending[1] if self._commands.ending else "")

    def update(self, record: DataRecorder) -> None:
        """Handle the prompt of the protocol, and show the progress every SHOW_S."""
        self._prompt(record)
        if self._socket is not None:
            self._stream.update(str(self._socket.path))
        if (now := time.monotonic()) - self._shown > SHOW_S:
            self._shown = now
            self._operator.show(record.progress())

    def _handle(self, command: OperatorCommand) -> CommandResult:
        """Execute a command, then record it."""
        if not self._memory.start_ns and command.action not in (CommandKind.STOP, CommandKind.VENT):
            return CommandResult(False, "the run has not begun")
        answer = self._commands.handle(command)
        if answer.accepted and self._memory.start_ns:
            self._event(Level.INFO, "operator", answer.message)
        return answer

    def _prompt(self, record: DataRecorder) -> None:
        waiting = self._memory.waiting_prompt
        if waiting < 0:
            return
        if waiting != self._shown_prompt:
            self._shown_prompt = waiting
            self._event(Level.INFO, "protocol", f"waiting for the operator: {self._prompt_text(waiting)}")
            self._operator.show(record.progress())
        elif self._memory.prompts_answered <= waiting and self._operator.answered():
            self._memory.prompts_answered = waiting + 1
            self._event(Level.INFO, "operator", f"done: {self._prompt_text(waiting)}")

    def _prompt_text(self, index: int) -> str:
        return self._plan.trajectory.prompts[index].message
