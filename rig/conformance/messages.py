"""Messages between the processes of a test, and their common end.

A message is one JSON object in a line, on a descriptor of its own: a driver may print on standard output.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
from dataclasses import asdict, dataclass
from typing import Any

from rig.conformance.timing import CheckTiming

WHERE = signal.SIGUSR1
"""Signal on which a process prints where it is."""
_PR_SET_PDEATHSIG = 1


@dataclass(frozen=True)
class CheckJob:
    """One check of one device; `kind` is card, camera or tracker, `unplugs` whether the device can be unplugged."""

    rig_file: str
    kind: str
    device: str
    check: str
    timing: CheckTiming
    unplugs: bool

    def text(self) -> str:
        """As JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def of(cls, text: str) -> CheckJob:
        """From JSON."""
        fields = json.loads(text)
        return cls(**fields | {"timing": CheckTiming(**fields["timing"])})


class Sender:
    """The end that sends; a driver's own children do not inherit it."""

    def __init__(self, descriptor: int) -> None:
        """Take over an inherited descriptor."""
        os.set_inheritable(descriptor, False)
        self._descriptor = descriptor

    def send(self, **facts: object) -> None:
        """Send a message; without effect once nobody listens."""
        line = (json.dumps(facts) + "\n").encode()
        try:
            while line:
                line = line[os.write(self._descriptor, line) :]
        except BrokenPipeError:
            return


def message(line: bytes | str) -> dict[str, Any]:
    """A message that was sent."""
    return dict(json.loads(line))


def end_with(parent: int) -> None:
    """Let the kernel kill this process when its parent ends: it must not go on driving the outputs."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)
