"""The emulated board seen from outside the guest: its D/A registers, its inputs and its faults, by QEMU's monitor."""

from __future__ import annotations

import json
import os
import select
from contextlib import suppress
from typing import Any

LINE = "/dev/ttyS1"
PATH = "/machine/peripheral/board"
ANSWER_S = 30.0
HANDSHAKE_S = 1.0
HANDSHAKES = 20
ABANDON = b"\xff"
"""Makes QEMU's parser forget what it has read: opening the line may have sent part of a character."""


class Monitor:
    """QEMU's monitor (QMP) at the end of the guest's serial line."""

    def __init__(self, line: str = LINE) -> None:
        self._line = os.open(line, os.O_RDWR | os.O_NOCTTY)
        self._rest = b""
        self._sent = 0
        for _ in range(HANDSHAKES):
            os.write(self._line, ABANDON)
            # After the first time it is an error, which does not matter.
            if self._answer(self._send("qmp_capabilities"), HANDSHAKE_S) is not None:
                return
        raise TimeoutError(f"QEMU's monitor does not answer on {line}")

    def close(self) -> None:
        """Close the line."""
        os.close(self._line)

    def get(self, name: str) -> Any:
        """A property of the board: `ao0`, `conversions`, ..."""
        return self._execute("qom-get", path=PATH, property=name)["return"]

    def set(self, name: str, value: object) -> None:
        """Set a voltage (`ai3`), the closed `contacts` at the digital inputs (one bit each), or a fault.

        Faults are `hung`, `irq-lost`, `irq-stuck`, `irq-storm-ms`, `open-inputs`.
        """
        self._execute("qom-set", path=PATH, property=name, value=value)

    def digital_writes(self, after_ns: int) -> list[tuple[int, int]]:
        """The last writes to the digital outputs after a time, oldest first: all lines as a number, and the time.

        Times are [ns] of the board.
        """
        pairs = (one.split(":") for one in self.get("digital-writes").split())
        return [(int(value), int(t_ns)) for value, t_ns in pairs if int(t_ns) > after_ns]

    @property
    def outputs_v(self) -> list[float]:
        """Voltages of the two D/A converters."""
        return [self.get("ao0"), self.get("ao1")]

    def _send(self, command: str, **arguments: object) -> int:
        """Send a command; its number, which the answer repeats."""
        self._sent += 1
        order = json.dumps({"execute": command, "arguments": arguments, "id": self._sent}).encode() + b"\n"
        while order:
            order = order[os.write(self._line, order) :]
        return self._sent

    def _execute(self, command: str, **arguments: object) -> dict[str, Any]:
        answer = self._answer(self._send(command, **arguments), ANSWER_S)
        if answer is None:
            raise TimeoutError(f"QEMU's monitor did not answer {command} {arguments} within {ANSWER_S:g} s")
        if "error" in answer:
            raise ValueError(f"{command} {arguments}: {answer['error']['desc']}")
        return answer

    def _answer(self, number: int, patience_s: float) -> dict[str, Any] | None:
        """The answer to that command; None where the line is silent for so long. Anything else is skipped."""
        while True:
            while b"\n" in self._rest:
                line, _, self._rest = self._rest.partition(b"\n")
                with suppress(TypeError, ValueError):  # the end of a message whose beginning was lost
                    answer = dict(json.loads(line))
                    if answer.get("id") == number:
                        return answer
            if not select.select([self._line], [], [], patience_s)[0]:
                return None
            self._rest += os.read(self._line, 4096)
