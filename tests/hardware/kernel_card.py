"""The card of the virtual machine: what the kernel's comedi_test is."""

from __future__ import annotations

from collections.abc import Callable

from rig.hardware.cards.base import Channel
from rig.hardware.cards.comedi import ComediCard

CARD = "/dev/comedi0"
BOARD = "comedi_test"
COUNT_V = 20 / 65535
OpenCard = Callable[..., ComediCard]


def bipolar(*numbers: int) -> tuple[Channel, ...]:
    """Channels in the card's widest range."""
    return tuple(Channel(number, -10.0, 10.0) for number in numbers)
