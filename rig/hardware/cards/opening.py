"""Opens the cards of a rig by the drivers of the rig file."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from rig.config.card_sections import CARD_DRIVERS, CardConfig
from rig.config.schema import RigConfig
from rig.hardware.cards.base import Card, CardError, CardSetup
from rig.hardware.release import release


def card_type(card: CardConfig) -> Callable[[CardSetup], Card]:
    """The driver of a card; loading it takes time, so a process that must react at once calls this beforehand.

    Raises:
        CardError: the driver cannot be loaded.
    """
    return CARD_DRIVERS[card.driver].load()


def open_card(card: CardConfig, setup: CardSetup) -> Card:
    """Open a card. Raises CardError: the card cannot be opened, for any reason."""
    driver = card_type(card)
    try:
        return driver(setup)
    except CardError:
        raise
    except Exception as error:  # the code of another package may raise anything
        raise CardError(f"card {setup.name}: {type(error).__name__}: {error}") from error


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
