"""Start the page's process: bind the address, create the tokens, return the links."""

from __future__ import annotations

import errno
import ipaddress
import os
import pickle
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from protocols import BadInputError
from protocols.problems import bad_input
from rig.execution.plan import StartError
from rig.live.authentication import AccessTokens
from rig.live.client_session import running_runs
from rig.realtime.control_socket import socket_of
from rig.realtime.operator_commands import user_name

LINGER_S = 3.0
"""Time after the end of a run in which browsers can fetch the last packet."""


@dataclass(frozen=True)
class PageConfiguration:
    """Listening socket `fd` and the source: `run` is a control socket, `archive` a file; one of them is None."""

    fd: int
    tokens: AccessTokens
    run: Path | None = None
    archive: Path | None = None


PORTS_TRIED = 20


@dataclass(frozen=True)
class PageProcess:
    """A page's process, and the lines to print for the operator."""

    process: subprocess.Popen[bytes]
    lines: tuple[str, ...]

    def close(self, patience_s: float = 0.0) -> None:
        """Wait `patience_s` for the process to exit, then terminate it."""
        try:
            self.process.wait(patience_s)
        except subprocess.TimeoutExpired:
            self.process.terminate()
            try:
                self.process.wait(3.0)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()


def open_page(listen: str, port: int, *, run: Path | None = None, archive: Path | None = None) -> PageProcess:
    """Start the page for a run (by its control socket) or an archive; use the first free port from `port` on.

    Raises:
        BadInputError: the address is not one of this machine.
        StartError: no port is free.
        ModuleNotFoundError: softrig is installed without the extra `live`.
    """
    if find_spec("nicegui") is None:
        raise ModuleNotFoundError("the live page needs NiceGUI", name="nicegui")
    address = _address(listen)
    bound = _bind(address, port)
    local = address.is_loopback
    tokens = AccessTokens(user_name() if local else None)
    configuration = PageConfiguration(bound.fileno(), tokens, run, archive)
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "rig.live.server"],
        stdin=subprocess.PIPE,
        pass_fds=[bound.fileno()],
        start_new_session=True,
    )
    assert process.stdin is not None
    try:
        pickle.dump(configuration, process.stdin)
        process.stdin.close()
    except BrokenPipeError:
        raise StartError(f"the page did not start (exit status {process.wait()})") from None
    base = _url(bound, address)
    bound.close()
    guest = f"{base}#{tokens.guest}  (view only)"
    if local:
        page = f"live page   {base}#{tokens.operator}  (keep it secret: it permits commands)"
        return PageProcess(process, (page, f"guest link  {guest}"))
    lines = (
        f"live page      {base}",
        f"operator link  {base}#{tokens.operator}  (opens once)",
        f"guest link     {guest}",
        "the connection is not encrypted: use it on a trusted network or through an SSH tunnel",
    )
    return PageProcess(process, lines)


@contextmanager
def live_page_of_this_run(listen: str, port: int, say: Callable[[str], None]) -> Iterator[None]:
    """Serve a page for the run that this process is about to start.

    Raises:
        StartError: the page cannot start.
    """
    page = open_page(listen, port, run=socket_of(os.getpid()))
    for line in page.lines:
        say(line)
    try:
        yield
    finally:
        page.close(LINGER_S)


def show(archive: Path | None, pid: int | None, listen: str, port: int, say: Callable[[str], None]) -> int:
    """Show an archive or a running experiment until it ends or Ctrl-C is pressed; return the exit status.

    Raises:
        ArchiveError: the file is no archive.
        BadInputError: no experiment is running, or several are and `pid` names none of them.
        StartError: the page cannot start.
    """
    if archive is not None:
        from runs.run import Run

        Run(archive)  # report an invalid file here, not in the page's process
    page = open_page(listen, port, run=None if archive else _socket_path(pid), archive=archive)
    for line in page.lines:
        say(line)
    try:
        return page.process.wait()
    except KeyboardInterrupt:
        return 0
    finally:
        page.close()


def _socket_path(pid: int | None) -> Path:
    found = [path for path in running_runs() if pid is None or path == socket_of(pid)]
    if len(found) == 1:
        return found[0]
    if found:
        pids = ", ".join(path.name.removeprefix("run-") for path in found)
        raise bad_input("--pid", "", f"several experiments are running; choose one by its process: {pids}")
    which = "no experiment of yours is running" if pid is None else f"process {pid} runs no experiment of yours"
    raise bad_input("--pid", "", f"{which}; start one with `rig run .. --live`, or name an archive to play")


def _address(listen: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    try:
        return ipaddress.ip_address(listen)
    except ValueError:
        raise _not_here(listen) from None


def _not_here(listen: str) -> BadInputError:
    expected = "an address of this machine, such as 192.168.1.20, or 0.0.0.0 for all"
    return bad_input("--listen", listen, expected)


def _bind(address: ipaddress.IPv4Address | ipaddress.IPv6Address, port: int) -> socket.socket:
    family = socket.AF_INET if address.version == 4 else socket.AF_INET6
    for candidate in range(port, min(port + PORTS_TRIED, 65536)):
        bound = socket.socket(family, socket.SOCK_STREAM)
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            bound.bind((str(address), candidate))
            bound.listen(64)
        except OSError as error:
            bound.close()
            if isinstance(error, PermissionError):
                raise StartError(f"port {candidate} may not be used: {error.strerror}") from error
            if error.errno == errno.EADDRNOTAVAIL:
                raise _not_here(str(address)) from error
        else:
            return bound
    raise StartError(f"no free port from {port} to {port + PORTS_TRIED - 1}; choose another with --port")


def _url(bound: socket.socket, address: ipaddress.IPv4Address | ipaddress.IPv6Address) -> str:
    port = bound.getsockname()[1]
    if address.is_unspecified:
        return f"http://{os.uname().nodename}:{port}/"
    return f"http://[{address}]:{port}/" if address.version == 6 else f"http://{address}:{port}/"
