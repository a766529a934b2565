"""Consistency of the units of valves, sensors and inputs with what their card gives and takes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from protocols.validation import ValidationFault

if TYPE_CHECKING:
    from rig.config.card_sections import CardConfig
    from rig.config.input_sections import AuxiliaryInput
    from rig.config.sections import Sensor
    from rig.valves.base import ValveSection

SIGNAL_UNITS = frozenset(("V", "bar"))
"""Units of softrig's own valves and sensors."""


def check(
    cards: Mapping[str, CardConfig | None],
    valves: Sequence[ValveSection | None],
    sensors: Sequence[Sensor | None],
    inputs: Mapping[str, AuxiliaryInput | None],
) -> Iterator[ValidationFault]:
    """Yield a fault for each number that the card would take or give in another unit."""
    users: list[tuple[tuple[str | int, ...], str, str]] = [
        *(
            (("valves", i, "type"), valve.card, valve.output_unit)
            for i, valve in enumerate(valves)
            if valve is not None
        ),
        *((("sensors", i, "unit"), sensor.card, sensor.unit) for i, sensor in enumerate(sensors) if sensor is not None),
        *((("inputs", name, "card"), one.card, "V") for name, one in inputs.items() if one is not None),
    ]
    for path, name, unit in users:
        card = cards.get(name)
        if card is None or card.signal_units is None or unit in card.signal_units:
            continue
        units = " or ".join(card.signal_units)
        expected = f"one with signals in {units}: card '{name}' ({card.driver}) has no signals in {unit}"
        if not SIGNAL_UNITS.intersection(card.signal_units):
            expected += f"; its driver converts {units} to {' or '.join(sorted(SIGNAL_UNITS))} (signal_units)"
        yield ValidationFault(path, expected)
