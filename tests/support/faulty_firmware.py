"""The reference firmware behind a line that changes what it reports, as a firmware with a fault would."""

from __future__ import annotations

import os
import select
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from rig.hardware.cards.serial_protocol import decoded, encoded

Words = list[str]
Fault = Callable[[Words], bytes]
"""Takes the words of a line from the firmware; returns the bytes that are sent instead."""
PRESSURISED_PA = 20_000


def honest(words: Words) -> bytes:
    """The line as the firmware meant it."""
    return encoded(" ".join(words))


class FaultyFirmware:
    """A controller whose reports are wrong from `after_s` after a chamber has been driven; None: from the start.

    `deaf`: from then on commands to vent are confirmed, and nothing vents, nor does it vent by itself.
    """

    def __init__(self, program: Path, fault: Fault, after_s: float | None, deaf: bool) -> None:
        self._master, self._slave = os.openpty()
        os.set_blocking(self._master, False)
        self.device = os.ttyname(self._slave)
        self._fault, self._after_s, self._deaf = fault, after_s, deaf
        self._firmware = subprocess.Popen(
            [program, "60000000" if deaf else "50000"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        self._driven_s = float("inf")
        self.begun_s = float("inf")
        """Time of the first wrong line."""
        self.safe_s = float("inf")
        """Time of the first command after it that vents every channel."""
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    @property
    def _wrong(self) -> bool:
        return self._after_s is None or time.monotonic() > self._driven_s + self._after_s

    def _serve(self) -> None:
        assert self._firmware.stdin is not None
        assert self._firmware.stdout is not None
        ends = {self._master: b"", self._firmware.stdout.fileno(): b""}
        while not self._ended.is_set():
            for end in select.select([*ends], [], [], 0.01)[0]:
                *lines, ends[end] = (ends[end] + os.read(end, 4096)).split(b"\n")
                for line in lines:
                    if end == self._master:
                        os.write(self._firmware.stdin.fileno(), self._command(line))
                    else:
                        with suppress(BlockingIOError):  # no reader: a serial line drops it, too
                            os.write(self._master, self._report(line))

    def _command(self, line: bytes) -> bytes:
        words = line.rpartition(b"*")[0].decode(errors="replace").split()
        if words[:1] != ["W"]:
            return line + b"\n"
        wanted = [int(word) for word in words[2:]]
        if max(wanted) > (0 if self._after_s is None else PRESSURISED_PA):
            self._driven_s = min(self._driven_s, time.monotonic())
        elif self._wrong and not any(wanted) and self._driven_s < float("inf"):
            self.safe_s = min(self.safe_s, time.monotonic())
            if self._deaf:
                self._confirmed = " ".join(words[2:])
                return encoded(" ".join([*words[:2], *[str(PRESSURISED_PA)] * len(wanted)]))
        return line + b"\n"

    def _report(self, line: bytes) -> bytes:
        words = line.rpartition(b"*")[0].decode(errors="replace").split()
        if self._deaf and words[0] == "I":
            return encoded(" ".join([*words[:-1], "50000"]))
        if decoded(line) is None or not self._wrong:
            return line + b"\n"
        if self._driven_s < float("inf"):
            self.begun_s = min(self.begun_s, time.monotonic())
        if self._deaf and words[0] == "A" and self.safe_s < float("inf"):
            words[2:] = ["0", *self._confirmed.split()]
        return self._fault(words)

    def close(self) -> None:
        """End the firmware and its line."""
        self._ended.set()
        self._thread.join()
        self._firmware.kill()
        self._firmware.wait()
        for pipe in (self._firmware.stdin, self._firmware.stdout):
            if pipe is not None:
                pipe.close()
        os.close(self._master)
        os.close(self._slave)


@contextmanager
def faulty_firmware(
    program: Path, fault: Fault, *, after_s: float | None = 1.0, deaf: bool = False
) -> Iterator[FaultyFirmware]:
    """A controller with a fault, running."""
    running = FaultyFirmware(program, fault, after_s, deaf)
    try:
        yield running
    finally:
        running.close()
