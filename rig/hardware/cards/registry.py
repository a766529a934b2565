"""Opening a rig's cards by the drivers that the rig file names."""

from __future__ import annotations

from collections.abc import Callable

from rig.config.drivers import CARD_DRIVERS
from rig.config.schema import CardConfig
from rig.hardware.cards.base import Card, CardSetup


def card_type(card: CardConfig) -> Callable[[CardSetup], Card]:
    """What opens a card; loading a driver takes time, so a process that must act at once calls this beforehand.

    Raises:
        CardError: the driver cannot be loaded.
    """
    return CARD_DRIVERS[card.driver].load()


def open_card(card: CardConfig, setup: CardSetup) -> Card:
    """Open a card.

    Raises:
        CardError: the card cannot be opened.
    """
    return card_type(card)(setup)
