"""The setup of a card, from the rig file."""

from __future__ import annotations

from rig.config.schema import RigConfig
from rig.hardware.cards.base import CardSetup, Channel


def card_setup(config: RigConfig, name: str) -> CardSetup:
    """The setup of one card of the rig: sensors in actuator order, valves in the order of the rig file."""
    card = config.cards[name]
    sensors = sorted((s for s in config.sensors if s.card == name), key=lambda s: s.actuator)
    valves = [v for v in config.valves if v.card == name]
    return CardSetup(
        name=name,
        device=card.device,
        inputs=tuple(Channel(s.channel, *s.signal_range) for s in sensors),
        outputs=tuple(Channel(v.channel, *v.output_range) for v in valves),
        sampling_hz=card.sampling_hz,
        section=card,
        **card.setup_options(),
    )
