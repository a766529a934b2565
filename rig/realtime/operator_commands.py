"""Commands of the operator to a running experiment, and their results."""

from __future__ import annotations

import os
import pwd
from dataclasses import dataclass
from enum import StrEnum

from protocols import SetPointTrajectory
from rig.realtime.shared_state import SharedState, Stop
from runs.records import Status


class CommandKind(StrEnum):
    """A command of the operator."""

    PAUSE = "pause"
    RESUME = "resume"
    SKIP = "skip"
    ANSWER = "answer"
    STOP = "stop"
    VENT = "vent"


@dataclass(frozen=True)
class OperatorCommand:
    """One command and its sender, such as `ada (live page)`."""

    action: CommandKind
    who: str


@dataclass(frozen=True)
class CommandResult:
    """Result of a command; `message` is the sentence for the record, or the reason of a refusal."""

    accepted: bool
    message: str


def user_name(uid: int | None = None) -> str:
    """Account name of a user id, by default of this process; `user 1234` if the machine has no name for it.

    The id comes from the kernel: variables such as LOGNAME and USER are not reliable.
    """
    uid = os.getuid() if uid is None else uid
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return f"user {uid}"


class CommandHandler:
    """Executes commands: sets the flags that control reads in its next cycle, then returns the result."""

    def __init__(self, memory: SharedState, trajectory: SetPointTrajectory) -> None:
        self._memory = memory
        self._trajectory = trajectory
        self.ending: tuple[Status, str] | None = None

    def handle(self, command: OperatorCommand) -> CommandResult:
        """Execute one command, or return why it is refused."""
        match command.action:
            case CommandKind.VENT:
                self._memory.request_stop(Stop.VENT)
                return self._end(f"vented by {command.who}")
            case CommandKind.STOP:
                self._memory.request_stop(Stop.SAFE)
                return self._end(f"stopped by {command.who}")
            case CommandKind.PAUSE | CommandKind.RESUME:
                return self._set_paused(command.action is CommandKind.PAUSE, command.who)
            case CommandKind.SKIP:
                return self._skip(command.who)
            case CommandKind.ANSWER:
                return self._answer(command.who)

    def _end(self, sentence: str) -> CommandResult:
        if self.ending is None:
            self.ending = Status.INTERRUPTED, sentence
        return CommandResult(True, sentence)

    def _set_paused(self, paused: bool, who: str) -> CommandResult:
        if self._memory.paused == paused:
            return CommandResult(False, "the run is paused already" if paused else "the run is not paused")
        self._memory.paused = paused
        return CommandResult(
            True, f"{'paused' if paused else 'resumed'} by {who} at protocol time {self._protocol_s:.2f} s"
        )

    def _skip(self, who: str) -> CommandResult:
        if self._memory.paused:
            # A paused run keeps its pressures.
            return CommandResult(False, "the run is paused and holds its pressures; resume it, then skip")
        at_s = self._protocol_s
        self._memory.skips = self._memory.skips + 1
        segment = self._trajectory.segment_at(at_s)
        return CommandResult(
            True, f"rest of '{segment.label or segment.kind}' skipped by {who} at protocol time {at_s:.2f} s"
        )

    def _answer(self, who: str) -> CommandResult:
        waiting = self._memory.waiting_prompt
        if waiting < 0 or self._memory.prompts_answered > waiting:
            return CommandResult(False, "no prompt waits for an answer")
        self._memory.prompts_answered = waiting + 1
        return CommandResult(True, f"done, says {who}: {self._trajectory.prompts[waiting].message}")

    @property
    def _protocol_s(self) -> float:
        return self._memory.protocol_s
