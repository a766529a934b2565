"""The cards of a rig, set up and opened by the drivers of the rig file."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from rig.config.card_sections import CARD_DRIVERS, CardConfig
from rig.config.schema import RigConfig
from rig.hardware.cards.base import Card, CardError, CardSetup, Channel
from rig.hardware.driver_calls import as_error, release


def card_setup(config: RigConfig, name: str, *, by_instruction: bool = False) -> CardSetup:
    """The setup of one card of the rig.

    Its inputs are the sensors in actuator order, then the auxiliary inputs; these, valves and emergency stops are in
    the order of the rig file. Its digital outputs are those that trigger cameras.
    """
    card = config.cards[name]
    sensors = [s for s in config.sensors_by_actuator if s.card == name]
    auxiliary = [i for i in config.inputs.values() if i.card == name]
    valves = [v for v in config.valves if v.card == name]
    triggers = [camera.trigger for camera in config.cameras.values()]
    return CardSetup(
        name=name,
        device=card.device,
        inputs=(
            *(Channel(s.channel, *s.signal_range) for s in sensors),
            *(Channel(i.channel, *i.range_V) for i in auxiliary),
        ),
        outputs=tuple(Channel(v.channel, *v.output_range) for v in valves),
        sampling_hz=card.sampling_hz,
        section=card,
        digital_inputs=tuple(stop.channel for stop in config.emergency_stops.values() if stop.card == name),
        digital_outputs=tuple(sorted({t.channel for t in triggers if t is not None and t.card == name})),
        by_instruction=by_instruction,
    )


def card_type(card: CardConfig) -> Callable[[CardSetup], Card]:
    """The driver of a card; loading it takes time, so a process that must react at once calls this beforehand.

    Raises:
        CardError: the driver cannot be loaded.
    """
    return CARD_DRIVERS[card.driver].load()


def open_card(card: CardConfig, setup: CardSetup) -> Card:
    """Open a card. Raises CardError: the card cannot be opened, for any reason."""
    driver = card_type(card)
    with as_error(CardError, f"card {setup.name}"):
        return driver(setup)


def open_cards(config: RigConfig, setups: Iterable[CardSetup]) -> dict[str, Card]:
    """Open cards of a rig; if one fails, release the others. Raises CardError: a card cannot be opened."""
    cards: dict[str, Card] = {}
    try:
        for setup in setups:
            cards[setup.name] = open_card(config.cards[setup.name], setup)
    except BaseException:
        release(cards.values())
        raise
    return cards
