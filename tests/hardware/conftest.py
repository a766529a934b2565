"""These tests drive the devices of a real kernel: they run in the virtual machine of `make test-hardware` only."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from kernel_card import CARD, OpenCard

from rig.daq.base import CardSetup, Channel
from rig.daq.comedi import ComediCard


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip outside the virtual machine: there the card is somebody's, with valves on it."""
    if os.environ.get("SOFTRIG_GUEST"):
        return
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.skip(reason="runs in the virtual machine: make test-hardware"))


@pytest.fixture
def out() -> Path:
    """Where the host finds what the guest leaves."""
    return Path(os.environ["SOFTRIG_GUEST_OUT"])


@pytest.fixture
def open_card() -> Iterator[OpenCard]:
    """Open cards that are closed after the test."""
    cards: list[ComediCard] = []

    def open_(
        inputs: tuple[Channel, ...] = (),
        outputs: tuple[Channel, ...] = (),
        *,
        device: str = CARD,
        acquisition: str = "auto",
        sampling_hz: float = 1000.0,
    ) -> ComediCard:
        card = ComediCard(CardSetup("daq", device, inputs, outputs, sampling_hz, acquisition))  # type: ignore[arg-type]
        cards.append(card)
        return card

    yield open_
    for card in cards:
        card.close()
