"""A child process that is never waited for without a time limit, and the end of what it prints."""

from __future__ import annotations

import json
import os
import re
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from rig.conformance.messages import WHERE, message

POLL_S = 0.05
KEPT_BYTES = 20_000
"""Of what a process prints: a driver may print without end."""
ENDS_S = 2.0
"""A killed process that has not ended by then waits inside the kernel."""
TOLD_S = 1.0
"""Time for a process to print where it hangs."""
_FRAME = re.compile(r'File "([^"]*)", line (\d+) in (\S+)')


class NoAnswerError(Exception):
    """The process has ended, or sends nothing; the message says which, and where it was."""


class HangsError(NoAnswerError):
    """The process sends nothing within the time limit."""


class StopRequestedError(Exception):
    """The operator ends the test."""


class Child:
    """A running `rig.conformance.child` in a session of its own, with all that it starts."""

    def __init__(self, mode: str, job: str) -> None:
        """Start it."""
        heard, sends = os.pipe()
        command = [sys.executable, "-P", "-X", "faulthandler", "-m", "rig.conformance.child", mode]
        self._process = subprocess.Popen(
            [*command, str(sends), str(os.getpid()), job],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            pass_fds=[sends],
            bufsize=0,
            start_new_session=True,
        )
        os.close(sends)
        assert self._process.stdout is not None
        self._pipes = selectors.DefaultSelector()
        self._messages, self._printed = heard, self._process.stdout.fileno()
        for descriptor in (self._messages, self._printed):
            self._pipes.register(descriptor, selectors.EVENT_READ)
        self._heard = self._said = b""

    def tell(self, **facts: object) -> None:
        """Send a request; a process that has ended is found out by the next `answer`."""
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):
            self._process.stdin.write((json.dumps(facts) + "\n").encode())

    def answer(self, limit_s: float, stop: Callable[[], bool] = lambda: False) -> dict[str, Any]:
        """The next message.

        Raises:
            NoAnswerError: there is none within the limit, or the process has ended.
            StopRequestedError: `stop` returns True meanwhile.
        """
        until = time.monotonic() + limit_s
        while b"\n" not in self._heard:
            ended = self._process.poll() is not None
            if not self._drain(0.0 if ended else POLL_S) and ended:
                raise NoAnswerError(self._ending())
            if stop():
                raise StopRequestedError
            if time.monotonic() > until:
                raise HangsError(f"it does not return within {limit_s:g} s{self._asked_where()}")
        line, _, self._heard = self._heard.partition(b"\n")
        return message(line)

    def close(self) -> None:
        """Kill the process and all that it has started in its session."""
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(ENDS_S)
        self._pipes.close()
        os.close(self._messages)
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            pipe.close()

    def _drain(self, timeout_s: float) -> bool:
        """Read what has come; True if there was anything."""
        found = False
        for key, _ in self._pipes.select(timeout_s):
            data = os.read(key.fd, 1 << 16)
            if not data:
                self._pipes.unregister(key.fd)
                time.sleep(POLL_S)  # its end is imminent
                continue
            found = True
            if key.fd == self._messages:
                self._heard += data
            else:
                self._said = (self._said + data)[-KEPT_BYTES:]
        return found

    def _ending(self) -> str:
        """How the process has ended, and where it was."""
        status = self._process.returncode
        how = f"with status {status}" if status >= 0 else f"by {signal.Signals(-status).name}"
        return f"its process ended {how}{self._where()}"

    def _asked_where(self) -> str:
        """Where a process hangs; empty if it does not tell."""
        self._said = b""
        with suppress(ProcessLookupError):
            os.kill(self._process.pid, WHERE)
        until = time.monotonic() + TOLD_S
        while time.monotonic() < until and not (where := self._where()):
            self._drain(POLL_S)
        return where

    def _where(self) -> str:
        """The innermost place in what faulthandler has printed of the current thread."""
        said = self._said.decode(errors="replace")
        frame = _FRAME.search(said, max(0, said.rfind("most recent call first")))
        return f", in {frame[3]} ({Path(frame[1]).name}, line {frame[2]})" if frame else ""
