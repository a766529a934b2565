"""Data-acquisition cards: the protocol they obey, Comedi, and the mock."""

from __future__ import annotations

from rig.config import CardConfig
from rig.daq.base import Card, CardSetup


def open_card(card: CardConfig, setup: CardSetup) -> Card:
    """Open a card with the driver that the rig names; a driver is imported only when it is used.

    Raises:
        CardError: the card cannot be opened.
    """
    if card.driver == "comedi":
        from rig.daq.comedi import ComediCard

        return ComediCard(setup)
    from rig.daq.mock import MockCard

    return MockCard(setup)
