"""Commands of the operator to a running experiment, and their results."""

from __future__ import annotations

import os
import pwd
from dataclasses import dataclass
from enum import StrEnum


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
