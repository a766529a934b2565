"""A simulated rig whose regulators also make vacuum."""

from __future__ import annotations

from rig.config import loader

VALVE = "  - {{type: pressure, actuators: {}, card: daq, channel: {}, span_bar: [-1, 1]{}}}\n"


def vacuum_text(*, lowest_bar: float = -0.6, supplies: str = ", supply_bar: 1.5, vacuum_bar: -0.8") -> str:
    """The mock rig with pressure regulators of -1 to 1 bar between two supplies, and sensors of the same span."""
    text = loader.text("mock")
    valves = "valves:\n" + VALVE.format("[1]", 0, supplies) + VALVE.format("[2, 3]", 1, supplies) + "\n"
    text = text[: text.index("valves:\n")] + valves + text[text.index("sensors:\n") :]
    for number in (1, 2, 3):
        channel = f"channel: {number - 1}"
        text = text.replace(f"actuator: {number}, card: daq, {channel}", f"actuator: {number}, card: daq, {channel},"
                            " span_bar: [-1, 2]")  # fmt: skip
    return text.replace("  pressure_bar: 0.7\n", f"  pressure_bar: 0.7\n  lowest_pressure_bar: {lowest_bar}\n")
