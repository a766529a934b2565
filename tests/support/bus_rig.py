"""The mock rig with regulators and sensors on a bus, whose numbers are in bar."""

from __future__ import annotations

import re

from rig.config import loader
from rig.config.schema import RigConfig

BUS = "  - {{type: bus, actuators: {}, card: daq, channel: {}, range_bar: [-0.8, 1.5]{}}}\n"


def bus_text(more: str = "", sensor: str = ", unit: bar, span_bar: [-1, 2]") -> str:
    """The mock rig with regulators and sensors on a bus."""
    text = loader.text("mock")
    valves = "valves:\n" + BUS.format("[1]", 0, more) + BUS.format("[2, 3]", 1, more) + "\n"
    text = text[: text.index("valves:\n")] + valves + text[text.index("sensors:\n") :]
    return re.sub(r"(actuator: \d, card: daq, channel: \d)", rf"\1{sensor}", text)


def bus_rig(more: str = "") -> RigConfig:
    return loader.parse(bus_text(more), "bus.yaml")
