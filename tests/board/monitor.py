"""The emulated board seen from outside the guest: its D/A registers, its inputs and its faults, by QEMU's monitor."""

from __future__ import annotations

import json
import os
import select
from typing import Any

LINE = "/dev/ttyS1"
PATH = "/machine/peripheral/board"
GREETING_S = 1.0


class Monitor:
    """QEMU's monitor (QMP) at the end of the guest's serial line."""

    def __init__(self, line: str = LINE) -> None:
        self._line = os.open(line, os.O_RDWR | os.O_NOCTTY)
        self._rest = b""
        # The greeting came before the guest listened. Where its end is lost, the first answer is lost with it.
        self._send("qmp_capabilities")
        while select.select([self._line], [], [], GREETING_S)[0]:
            os.read(self._line, 4096)
        self._execute("qmp_capabilities")

    def close(self) -> None:
        """Close the line."""
        os.close(self._line)

    def get(self, name: str) -> Any:
        """A property of the board: `ao0`, `conversions`, ..."""
        return self._execute("qom-get", path=PATH, property=name)["return"]

    def set(self, name: str, value: object) -> None:
        """Set a voltage (`ai3`) or a fault (`hung`, `irq-lost`, `irq-stuck`, `open-inputs`)."""
        self._execute("qom-set", path=PATH, property=name, value=value)

    @property
    def outputs_v(self) -> list[float]:
        """Voltages of the two D/A converters."""
        return [self.get("ao0"), self.get("ao1")]

    def _send(self, command: str, **arguments: object) -> None:
        order = json.dumps({"execute": command, "arguments": arguments, "id": command}).encode() + b"\n"
        while order:
            order = order[os.write(self._line, order) :]

    def _execute(self, command: str, **arguments: object) -> dict[str, Any]:
        self._send(command, **arguments)
        while True:
            answer = self._next()
            if answer.get("id") == command:
                if "error" in answer and command != "qmp_capabilities":  # a second time is an error, and no matter
                    raise ValueError(f"{command} {arguments}: {answer['error']['desc']}")
                return answer

    def _next(self) -> dict[str, Any]:
        while b"\n" not in self._rest:
            self._rest += os.read(self._line, 4096)
        line, _, self._rest = self._rest.partition(b"\n")
        try:
            return dict(json.loads(line))
        except ValueError:  # the end of a greeting whose beginning came before the guest listened
            return {}
