"""Check of a rig's Comedi card: channels and ranges, and the effect of 0 V on its valves."""

from __future__ import annotations

from collections.abc import Iterator

from rig.config.drivers import Finding
from rig.config.schema import RigConfig
from rig.doctor.cards import POWER_UP
from rig.hardware.cards.base import CardError
from rig.hardware.cards.comedi import ComediCard
from rig.hardware.cards.opening import card_setup


def examine(config: RigConfig, name: str) -> Iterator[Finding]:
    """Check one card against the channels and ranges that the rig uses; opens it, and writes no channel."""
    topic = f"rig's card {name}"
    try:
        opened = ComediCard(card_setup(config, name))
    except CardError as error:
        remedy = error.remedy or f"change card '{name}' of the rig, or use another card"
        yield Finding(topic, "missing", error.what, remedy)
    else:
        used = sum(valve.card == name for valve in config.valves)
        left = opened.outputs_there - used
        yield Finding(
            topic,
            "ok",
            f"{opened.description} has every channel and range that the rig uses; "
            f"{used} of {opened.outputs_there} outputs used, {left or 'none'} left",
        )
        opened.close()
    for number, valve in enumerate(config.valves, 1):
        if valve.card == name and valve.fills_at_power_up:
            yield Finding(
                f"rig's valve {number}",
                "note",
                "at 0 V, where attaching the driver puts it, it FILLS its chamber up to the supply's pressure",
                f"connect the chamber to port 4 (fills: above); until then {POWER_UP}",
            )
