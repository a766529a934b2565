"""Data-acquisition cards: the protocol they obey, Comedi, and the mock."""

from __future__ import annotations

from collections.abc import Callable

from rig.config.schema import CardConfig
from rig.hardware.cards.base import Card, CardSetup


def card_type(card: CardConfig) -> Callable[[CardSetup], Card]:
    """What opens a card with the driver that the rig names; a driver is loaded only when it is used.

    Raises:
        CardError: the driver cannot be loaded.
    """
    if card.driver == "comedi":
        from rig.hardware.cards.comedi import ComediCard
        from rig.hardware.cards.comedi_device import require

        require()
        return ComediCard
    from rig.hardware.cards.mock import MockCard

    return MockCard


def open_card(card: CardConfig, setup: CardSetup) -> Card:
    """Open a card.

    Raises:
        CardError: the card cannot be opened.
    """
    return card_type(card)(setup)
