"""A rig without a camera whose three chambers are driven by a pressure controller on a serial port."""

from __future__ import annotations

import re

from rig.config import loader

_VALVE = "  - {{type: bus, actuators: [{}], card: daq, channel: {}, range_bar: [0, 1.5]}}\n"


def serial_text(device: str) -> str:
    """The rig file of the controller at a port, with the limits of the rig `mock-no-camera`."""
    text = loader.text("mock-no-camera")
    text = text[: text.index("simulator:\n")]
    text = re.sub(r"daq: \{driver: mock.*\}", f"daq: {{driver: serial, device: {device}, inputs: 4, outputs: 4}}", text)
    valves = "valves:\n" + "".join(_VALVE.format(n + 1, n) for n in range(3)) + "\n"
    text = text[: text.index("valves:\n")] + valves + text[text.index("sensors:\n") :]
    return re.sub(r"(actuator: \d, card: daq, channel: \d)", r"\1, unit: bar, span_bar: [-1, 9]", text)
