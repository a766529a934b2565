"""Client of a run's control socket: attaches to the shared memory read-only and sends operator commands."""

from __future__ import annotations

import json
import os
import pickle
import socket
import struct
from pathlib import Path
from typing import Any

from rig.execution.plan import RunPlan, StartError
from rig.realtime.control_socket import PACKET_BYTES, socket_paths
from rig.realtime.shared_state import SharedState

TIMEOUT_S = 5.0


def connect(path: Path) -> socket.socket | None:
    """Connect to a run's control socket; return None where no process listens."""
    client = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    # Only a blocking connect waits for a busy listener; SO_SNDTIMEO limits the wait.
    client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack("ll", round(TIMEOUT_S), 0))
    try:
        client.connect(os.fspath(path))
    except OSError:
        client.close()
        return None
    client.settimeout(TIMEOUT_S)
    return client


def running_runs() -> list[Path]:
    """Return the control sockets of this user's running experiments."""
    found = []
    for path in sorted(socket_paths().glob("run-*")):
        if client := connect(path):
            client.close()
            found.append(path)
    return found


class ClientSession:
    """A session with a run: its `plan` and its `memory`, mapped read-only."""

    def __init__(self, path: Path) -> None:
        """Attach.

        Raises:
            StartError: the run has ended, or does not answer.
        """
        connection = connect(path)
        if connection is None:
            raise StartError(f"no run is active at {path}")
        self._path = path
        self._connection = connection
        try:
            connection.send(b'{"do": "attach"}')
            _, fds, _, _ = socket.recv_fds(connection, PACKET_BYTES, 2)
            memory_fd, plan_fd = fds
        except (OSError, ValueError) as error:
            connection.close()
            raise StartError(f"the run at {path} does not answer: {error}") from error
        with os.fdopen(plan_fd, "rb") as file:
            file.seek(0)
            self.plan: RunPlan = pickle.load(file)  # written by a run of this user, in a folder of mode 0700
        self.memory = SharedState(memory_fd, self.plan.config, len(self.plan.adapted), readonly=True)
        connection.setblocking(False)
        self.ended = False

    def watch(self) -> None:
        """Tell the run that a viewer is present; repeat about once a second."""
        try:
            self._connection.send(b'{"do": "watch"}')
        except BlockingIOError:
            pass
        except OSError:
            self.ended = True

    def request(self, do: str, who: str, via: str = "live page") -> dict[str, Any]:
        """Send an operator command and wait for the reply, `done` and `message`. Thread-safe.

        `who` names the operator, `via` the program; the record adds the account of this process.
        """
        connection = connect(self._path)
        if connection is None:
            return {"done": False, "message": "the run has ended"}
        with connection:
            try:
                connection.send(json.dumps({"do": do, "who": who, "via": via}).encode())
                if answer := connection.recv(PACKET_BYTES):
                    reply: dict[str, Any] = json.loads(answer)
                    return reply
            except TimeoutError:
                return {"done": False, "message": "the run did not answer"}
            except OSError:
                pass
        return {"done": False, "message": "the run has ended"}

    def check_ended(self) -> None:
        """Set `ended` when the run has closed the connection."""
        try:
            self.ended = self.ended or not self._connection.recv(PACKET_BYTES, socket.MSG_PEEK)
        except BlockingIOError:
            pass
        except OSError:
            self.ended = True

    def close(self) -> None:
        self._connection.close()
        os.close(self.memory.fd)
