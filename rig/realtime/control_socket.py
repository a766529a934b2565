"""The supervisor's control socket: a page of the same user reads the run's data there and asks for actions.

Packets are JSON objects. `{"do": "attach"}` is answered with two file descriptors: the run's memory, read-only, and a
pickle of its plan. `{"do": "watch"}` reports that a viewer is present. Any other `do` is an `Action`; `via` names the
program that asks, `who` the person who uses it, if known. The record names the account behind the connection, which
the kernel reports (SO_PEERCRED), whatever `who` says. Only the run's own user and root are let in.
The supervisor never waits for a client: one that does not read its answer, or sends no valid packet, is disconnected.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import pickle
import select
import socket
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rig.execution.plan import Plan
from rig.hardware.runtime_folder import subfolder
from rig.realtime.operator_commands import Command, CommandResult, OperatorCommand, user_name
from rig.realtime.shared_state import SharedState

PACKET_BYTES = 4096
MOST_VISITORS = 32
MOST_PACKETS = 32
"""Packets taken from one visitor at a time, so that a flood cannot hold the supervisor up."""
MOST_NAME = 40
_PEER = struct.Struct("3i")

HandleCommand = Callable[[OperatorCommand], CommandResult]


def socket_paths() -> Path:
    """The folder of the control sockets of this user's runs; made when it is missing.

    Raises:
        OSError: it cannot be made, or is open to other users.
    """
    return subfolder("sockets")


def socket_of(pid: int) -> Path:
    """Where the run conducted by a process is to be asked."""
    return socket_paths() / f"run-{pid}"


def _clear_away() -> None:
    """Remove the doors that killed runs have left: nobody answers there."""
    for path in socket_paths().glob("run-*"):
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK) as visitor:
            try:
                visitor.connect(os.fspath(path))
            except ConnectionRefusedError:
                path.unlink(missing_ok=True)
            except OSError:
                continue


class ControlSocket:
    """The open door of one run. `close` may be called more than once."""

    def __init__(self, plan: Plan, memory: SharedState) -> None:
        """Open it.

        Raises:
            OSError: the socket cannot be made.
        """
        self._memory = memory
        self._visitors: list[socket.socket] = []
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
        _clear_away()
        self.path = socket_of(os.getpid())
        self.path.unlink(missing_ok=True)
        self._socket.bind(os.fspath(self.path))
        self._socket.listen(MOST_VISITORS)
        self._view_fd = os.open(f"/proc/self/fd/{memory.fd}", os.O_RDONLY | os.O_CLOEXEC)
        self._plan_fd = os.memfd_create("softrig-plan", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        with os.fdopen(os.dup(self._plan_fd), "wb") as file:
            pickle.dump(plan, file)
        fcntl.fcntl(self._plan_fd, fcntl.F_ADD_SEALS, fcntl.F_SEAL_WRITE | fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW)

    def serve(self, timeout_s: float, handle: HandleCommand) -> None:
        """Wait for at most `timeout_s`, less when somebody wants something, and give him what he wants."""
        ready, _, _ = select.select([*self._visitors, self._socket], [], [], timeout_s)
        for end in ready:
            # Who has just come in often wants something already.
            visitor = self._let_in() if end is self._socket else end
            if visitor is not None and not self._read_packets(visitor, handle):
                self._visitors.remove(visitor)
                visitor.close()

    def close(self) -> None:
        """Shut the door; visitors see the connection end."""
        self.path.unlink(missing_ok=True)
        for end in (self._socket, *self._visitors):
            end.close()
        self._visitors.clear()
        for fd in (self._view_fd, self._plan_fd):
            if fd >= 0:
                os.close(fd)
        self._view_fd = self._plan_fd = -1

    def _let_in(self) -> socket.socket | None:
        with contextlib.suppress(OSError):
            visitor, _ = self._socket.accept()
            visitor.setblocking(False)
            if _uid(visitor) in (0, os.getuid()) and len(self._visitors) < MOST_VISITORS:
                self._visitors.append(visitor)
                return visitor
            visitor.close()
        return None

    def _read_packets(self, visitor: socket.socket, handle: HandleCommand) -> bool:
        """Answer what lies there; False when the visitor has gone or has to."""
        try:
            for _ in range(MOST_PACKETS):
                packet = visitor.recv(PACKET_BYTES)
                if not packet:
                    return False
                self._answer(visitor, json.loads(packet), handle)
        except BlockingIOError:
            return True
        except (OSError, ValueError, TypeError, AttributeError, RecursionError):
            return False
        return True

    def _answer(self, visitor: socket.socket, wish: dict[str, Any], handle: HandleCommand) -> None:
        do = wish.get("do")
        if do == "watch":
            self._memory.viewer_ns = time.monotonic_ns()
        elif do == "attach":
            socket.send_fds(visitor, [b'{"done": true, "said": ""}'], [self._view_fd, self._plan_fd])
        elif not isinstance(do, str):
            raise TypeError("an action is a word")
        else:
            answer = handle(OperatorCommand(Command(do), _named(_uid(visitor), wish.get("who"), wish.get("via"))))
            visitor.send(json.dumps({"done": answer.accepted, "said": answer.message}).encode())


def _uid(visitor: socket.socket) -> int:
    """The user id behind a connection."""
    _, uid, _ = _PEER.unpack(visitor.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size))
    return int(uid)


def _named(uid: int, who: object, via: object) -> str:
    """Who acts, for the record: `ada (live page)`; with a name that somebody else gave, `eve (live page of ada)`."""
    account = user_name(uid)
    program = printable(via) or "control socket"
    person = printable(who)
    return f"{account} ({program})" if person in ("", account) else f"{person} ({program} of {account})"


def printable(name: object) -> str:
    """A short name on one line, without control characters and bidirectional marks; empty for what is no text."""
    shown = "".join(c for c in name if c.isprintable()) if isinstance(name, str) else ""
    return " ".join(shown.split())[:MOST_NAME]
