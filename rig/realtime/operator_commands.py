"""What an operator may ask of a run that goes, and how the run answers."""

from __future__ import annotations

import os
import pwd
from dataclasses import dataclass
from enum import StrEnum

from protocols import Trajectory
from rig.realtime.shared_state import SharedState, Stop
from runs.records import Status


class Command(StrEnum):
    """Something an operator can ask for."""

    PAUSE = "pause"
    RESUME = "resume"
    SKIP = "skip"
    ANSWER = "answer"
    STOP = "stop"
    VENT = "vent"


@dataclass(frozen=True)
class OperatorCommand:
    """One action, and who asks for it: `ada (live page)`."""

    action: Command
    who: str


@dataclass(frozen=True)
class CommandResult:
    """What became of a wish: `said` is a sentence for the record, or the reason why nothing was done."""

    accepted: bool
    message: str


def user_name(uid: int | None = None) -> str:
    """The account with a user id, this process's own if left out; `user 1234` where the machine has no name for it.

    The kernel's id decides: variables such as LOGNAME and USER can say anything.
    """
    uid = os.getuid() if uid is None else uid
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return f"user {uid}"


class CommandHandler:
    """Carries wishes out: sets the flags that control obeys at its next tick. What it says comes after what it does."""

    def __init__(self, memory: SharedState, trajectory: Trajectory) -> None:
        self._memory = memory
        self._trajectory = trajectory
        self.ending: tuple[Status, str] | None = None

    def handle(self, request: OperatorCommand) -> CommandResult:
        """Do one thing, or say why not."""
        match request.action:
            case Command.VENT:
                self._memory.request_stop(Stop.VENT)
                return self._end(f"vented by {request.who}")
            case Command.STOP:
                self._memory.request_stop(Stop.SAFE)
                return self._end(f"stopped by {request.who}")
            case Command.PAUSE | Command.RESUME:
                return self._hold(request.action is Command.PAUSE, request.who)
            case Command.SKIP:
                return self._skip(request.who)
            case Command.ANSWER:
                return self._answer(request.who)

    def _end(self, sentence: str) -> CommandResult:
        if self.ending is None:
            self.ending = Status.INTERRUPTED, sentence
        return CommandResult(True, sentence)

    def _hold(self, paused: bool, who: str) -> CommandResult:
        if self._memory.paused == paused:
            return CommandResult(False, "the run is paused already" if paused else "the run is not paused")
        self._memory.paused = paused
        return CommandResult(
            True, f"{'paused' if paused else 'resumed'} by {who} at protocol time {self._protocol_s:.2f} s"
        )

    def _skip(self, who: str) -> CommandResult:
        if self._memory.paused:
            # Whoever pauses counts on the pressures to stay as they are.
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
