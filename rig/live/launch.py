"""Start the process of the page: bind the address, create the tokens, print the links."""

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


@dataclass(frozen=True)
class PageConfiguration:
    """Listening socket `fd`, the tokens, and the control socket of the run to show."""

    fd: int
    tokens: AccessTokens
    run: Path


@dataclass(frozen=True)
class PageProcess:
    """A page's process, and the lines to print for the operator."""

    process: subprocess.Popen[bytes]
    lines: tuple[str, ...]

    def close(self) -> None:
        """Terminate the process."""
        self.process.terminate()
        try:
            self.process.wait(3.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


def open_page(host: str, port: int, run: Path) -> PageProcess:
    """Start the page for the run with this control socket, at `port` or, where that is taken, at any free port.

    Raises:
        BadInputError: the address is not one of this machine.
        StartError: the port may not be used.
        ModuleNotFoundError: softrig is installed without the extra `live`.
    """
    if find_spec("nicegui") is None:
        raise ModuleNotFoundError("the live page needs NiceGUI", name="nicegui")
    address = _address(host)
    bound = _bind(address, port)
    tokens = AccessTokens(user_name())
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "rig.live.server"],
        stdin=subprocess.PIPE,
        pass_fds=[bound.fileno()],
        start_new_session=True,
    )
    assert process.stdin is not None
    try:
        pickle.dump(PageConfiguration(bound.fileno(), tokens, run), process.stdin)
        process.stdin.close()
    except BrokenPipeError:
        raise StartError(f"the page did not start (exit status {process.wait()})") from None
    url = _url(bound, address)
    bound.close()
    lines = [
        f"live page  {url}?token={tokens.operate}  (keep it secret: it permits commands)",
        f"view only  {url}?token={tokens.read}",
    ]
    if not address.is_loopback:
        lines.append("the connection is not encrypted: use it on a trusted network or through an SSH tunnel")
    return PageProcess(process, tuple(lines))


@contextmanager
def live_page_of_this_run(host: str, port: int, say: Callable[[str], None]) -> Iterator[None]:
    """Serve a page for the run that this process is about to start; it outlasts the run while somebody watches.

    Raises:
        StartError: the page cannot start.
    """
    page = open_page(host, port, socket_of(os.getpid()))
    for line in page.lines:
        say(line)
    try:
        yield
    except BaseException:
        page.close()
        raise


def show(pid: int | None, host: str, port: int, say: Callable[[str], None]) -> int:
    """Show a running experiment until it ends or Ctrl-C is pressed; return the exit status.

    Raises:
        BadInputError: no experiment is running, or several are and `pid` names none of them.
        StartError: the page cannot start.
    """
    page = open_page(host, port, _socket_path(pid))
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
    raise bad_input("--pid", "", f"{which}; start one with `rig run .. --live`")


def _address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        raise _not_here(host) from None


def _not_here(host: str) -> BadInputError:
    expected = "an address of this machine, such as 192.168.1.20, or 0.0.0.0 for all"
    return bad_input("--host", host, expected)


def _bind(address: ipaddress.IPv4Address | ipaddress.IPv6Address, port: int) -> socket.socket:
    """Return a socket that listens at a port or, where another program listens there, at any free port."""
    bound = socket.socket(socket.AF_INET if address.version == 4 else socket.AF_INET6, socket.SOCK_STREAM)
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        bound.bind((str(address), port))
        bound.listen()
    except OSError as error:
        bound.close()
        if error.errno == errno.EADDRINUSE and port:
            return _bind(address, 0)
        if error.errno == errno.EADDRNOTAVAIL:
            raise _not_here(str(address)) from error
        raise StartError(f"port {port} may not be used: {error.strerror}") from error
    return bound


def _url(bound: socket.socket, address: ipaddress.IPv4Address | ipaddress.IPv6Address) -> str:
    port = bound.getsockname()[1]
    if address.is_unspecified:
        return f"http://{os.uname().nodename}:{port}/"
    return f"http://[{address}]:{port}/" if address.version == 6 else f"http://{address}:{port}/"
