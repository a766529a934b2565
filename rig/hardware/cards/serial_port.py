"""A serial port without waiting, for one process at a time."""

from __future__ import annotations

import fcntl
import os
import struct
import termios
import tty
from contextlib import suppress
from pathlib import Path

from rig.hardware.cards.base import CardBusyError, CardError
from rig.hardware.cards.kernel_devices import processes_with

# struct flock: a write lock on the whole file.
_WHOLE_FILE = struct.pack("hhqqi4x", fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0)
_CHUNK = 65536


class SerialPort:
    """An open port in raw mode; closing it leaves the modem lines as they are, because they reset some boards."""

    def __init__(self, path: str, baud: int) -> None:
        """Open a port.

        The lock belongs to the open file: the kernel releases it when the process dies, and it excludes no other kind
        of lock on the port.

        Raises:
            CardError: there is no such port, or another process has it.
        """
        self.path = path
        try:
            self._file = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        except FileNotFoundError:
            raise CardError(
                f"{path} does not exist", "plug the controller in; /dev/serial/by-id has lasting names"
            ) from None
        except PermissionError:
            raise CardError(f"no permission to open {path}", "sudo adduser $USER dialout, then log in again") from None
        except OSError as error:
            raise CardError(f"{path} cannot be opened: {error.strerror}") from None
        try:
            fcntl.fcntl(self._file, fcntl.F_OFD_SETLK, _WHOLE_FILE)
            self._configure(baud)
        except BlockingIOError:
            os.close(self._file)
            raise CardBusyError(path, _locker(path)) from None
        except (OSError, termios.error) as error:
            os.close(self._file)
            raise CardError(f"{path} is no serial port: {error.args[-1]}") from None

    def _configure(self, baud: int) -> None:
        speed = getattr(termios, f"B{baud}")
        tty.setraw(self._file, termios.TCSANOW)
        mode = termios.tcgetattr(self._file)
        mode[2] = (mode[2] | termios.CLOCAL | termios.CREAD) & ~termios.HUPCL & ~termios.CRTSCTS
        mode[4] = mode[5] = speed
        termios.tcsetattr(self._file, termios.TCSANOW, mode)
        termios.tcflush(self._file, termios.TCIFLUSH)

    def read(self) -> bytes:
        """What has been received; does not wait. Raises CardError."""
        try:
            received = os.read(self._file, _CHUNK)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise CardError(f"{self.path} cannot be read: {error.strerror}", "is the cable in?") from None
        if not received:
            raise CardError(f"{self.path} has gone", "is the cable in?")
        return received

    def write(self, line: bytes) -> None:
        """Send a line; does not wait. Raises CardError."""
        try:
            sent = os.write(self._file, line)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            raise CardError(f"{self.path} cannot be written: {error.strerror}", "is the cable in?") from None
        if sent < len(line):
            raise CardError(f"{self.path} takes no more data: does the controller read?")

    def close(self) -> None:
        file, self._file = self._file, -1  # another file may have the number later
        with suppress(OSError):
            os.close(file)


def _locker(path: str) -> tuple[int, ...]:
    """The process that has locked a port: other processes of a run have it open, too, for the lock of the rig."""
    found = []
    for pid in processes_with(path):
        with suppress(OSError):
            if any("OFDLCK" in about.read_text() for about in Path(f"/proc/{pid}/fdinfo").iterdir()):
                found.append(pid)
    return tuple(found)
