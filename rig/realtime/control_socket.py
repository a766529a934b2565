"""The supervisor's control socket: clients of the same user read the data of the run and send commands.

Packets are JSON objects. `{"do": "attach"}` is answered with two file descriptors: the run's memory, read-only, and a
pickle of its plan. `{"do": "watch"}` reports that a viewer is present. `{"do": "stream", ..}` is a set-point of another
program, `{"do": "state"}` asks for what that program needs (`rig.realtime.stream_receiver`). Any other `do` is a
`CommandKind`; `via` names the client program, `who` its user, if known. The record names the account of the connection,
which the kernel reports (SO_PEERCRED), independent of `who`. Only the user of the run and root may connect.
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

from rig.execution.plan import RunPlan
from rig.hardware.runtime_folder import subfolder
from rig.realtime.operator_commands import CommandKind, CommandResult, OperatorCommand, user_name
from rig.realtime.shared_state import SharedState
from rig.realtime.stream_receiver import StreamReceiver

PACKET_BYTES = 4096
MAX_CLIENTS = 32
MAX_PACKETS = 32
"""Packets read from one client at a time, so that a flood of packets cannot delay the supervisor."""
MAX_NAME = 40
_PEER = struct.Struct("3i")

HandleCommand = Callable[[OperatorCommand], CommandResult]


def socket_paths() -> Path:
    """Folder of the control sockets of this user's runs; created if it is missing.

    Raises:
        OSError: it cannot be created, or other users can enter it.
    """
    return subfolder("sockets")


def socket_of(pid: int) -> Path:
    """Control socket of the run whose supervisor has this process id."""
    return socket_paths() / f"run-{pid}"


def _remove_stale_sockets() -> None:
    """Remove the sockets of killed runs, which refuse every connection."""
    for path in socket_paths().glob("run-*"):
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK) as client:
            try:
                client.connect(os.fspath(path))
            except ConnectionRefusedError:
                path.unlink(missing_ok=True)
            except OSError:
                continue


_COMMANDS = ["watch", "attach", "state", "stream", *(kind.value for kind in CommandKind)]
_REFUSAL = json.dumps(
    {"done": False, "message": f'expected a JSON object whose "do" is one of {", ".join(_COMMANDS)}'}
).encode()


class ControlSocket:
    """The listening control socket of one run. `close` may be called more than once."""

    def __init__(self, plan: RunPlan, memory: SharedState, stream: StreamReceiver) -> None:
        """Create and bind the socket. Raises OSError: the socket cannot be created."""
        self._memory, self._stream = memory, stream
        self._clients: dict[socket.socket, int] = {}
        """The connections, each with its number."""
        self._accepted = 0
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
        _remove_stale_sockets()
        self.path = socket_of(os.getpid())
        self.path.unlink(missing_ok=True)
        self._socket.bind(os.fspath(self.path))
        self._socket.listen(MAX_CLIENTS)
        self._view_fd = os.open(f"/proc/self/fd/{memory.fd}", os.O_RDONLY | os.O_CLOEXEC)
        self._plan_fd = os.memfd_create("softrig-plan", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        with os.fdopen(os.dup(self._plan_fd), "wb") as file:
            pickle.dump(plan, file)
        fcntl.fcntl(self._plan_fd, fcntl.F_ADD_SEALS, fcntl.F_SEAL_WRITE | fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW)

    def serve(self, timeout_s: float, handle: HandleCommand) -> None:
        """Wait at most `timeout_s` for packets of clients, and answer them."""
        ready, _, _ = select.select([*self._clients, self._socket], [], [], timeout_s)
        for end in ready:
            # A new client has often sent its first packet already.
            client = self._accept() if end is self._socket else end
            if client is not None and not self._read_packets(client, handle):
                self._stream.disconnected(self._clients.pop(client))
                client.close()

    def close(self) -> None:
        self.path.unlink(missing_ok=True)
        for end in (self._socket, *self._clients):
            end.close()
        self._clients.clear()
        for fd in (self._view_fd, self._plan_fd):
            if fd >= 0:
                os.close(fd)
        self._view_fd = self._plan_fd = -1

    def _accept(self) -> socket.socket | None:
        with contextlib.suppress(OSError):
            client, _ = self._socket.accept()
            client.setblocking(False)
            if _uid(client) in (0, os.getuid()) and len(self._clients) < MAX_CLIENTS:
                self._accepted += 1
                self._clients[client] = self._accepted
                return client
            client.close()
        return None

    def _read_packets(self, client: socket.socket, handle: HandleCommand) -> bool:
        """Answer the waiting packets; False if the client has disconnected or must be disconnected."""
        try:
            for _ in range(MAX_PACKETS):
                packet = client.recv(PACKET_BYTES)
                if not packet:
                    return False
                if (decoded := _decoded(packet)) is None:
                    client.send(_REFUSAL)
                else:
                    self._answer(client, decoded, handle)
        except BlockingIOError:
            return True
        except OSError:
            return False
        return True

    def _answer(self, client: socket.socket, packet: dict[str, Any], handle: HandleCommand) -> None:
        do = packet["do"]
        if do == "watch":
            self._memory.viewer_ns = time.monotonic_ns()
        elif do == "attach":
            socket.send_fds(client, [b'{"done": true, "message": ""}'], [self._view_fd, self._plan_fd])
        elif do == "state":
            client.send(json.dumps({"done": True, "message": "", **self._stream.state()}).encode())
        elif do == "stream":
            sender = _named(_uid(client), packet.get("who"), packet.get("via"))
            client.send(json.dumps(self._stream.take(self._clients[client], sender, packet)).encode())
        else:
            answer = handle(
                OperatorCommand(CommandKind(do), _named(_uid(client), packet.get("who"), packet.get("via")))
            )
            client.send(json.dumps({"done": answer.accepted, "message": answer.message}).encode())


def _decoded(packet: bytes) -> dict[str, Any] | None:
    """A packet with a known command; None for any other."""
    try:
        content = json.loads(packet)
    except (ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) and content.get("do") in _COMMANDS else None


def _uid(client: socket.socket) -> int:
    _, uid, _ = _PEER.unpack(client.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size))
    return int(uid)


def _named(uid: int, who: object, via: object) -> str:
    """Sender for the record: `ada (live page)`; if the client states another name, `eve (live page of ada)`."""
    account = user_name(uid)
    program = display_name(via) or "control socket"
    person = display_name(who)
    return f"{account} ({program})" if person in ("", account) else f"{person} ({program} of {account})"


def display_name(name: object) -> str:
    """A short name on one line, without control characters and bidirectional marks; empty if it is not a string."""
    shown = "".join(c for c in name if c.isprintable()) if isinstance(name, str) else ""
    return " ".join(shown.split())[:MAX_NAME]
