"""The time limit of calls into drivers."""

from __future__ import annotations

import threading

import pytest

from rig.hardware.call_limit import within
from rig.hardware.cards.base import CardError


def test_a_call_that_returns_gives_its_value_and_its_error() -> None:
    def broken() -> int:
        raise OSError("cable pulled")

    assert within(lambda: 3) == 3
    with pytest.raises(OSError, match="cable pulled"):
        within(broken)


def test_a_call_that_does_not_return_is_an_error_of_the_card_and_its_caller_shows_that_it_is_alive() -> None:
    released = threading.Event()
    signs: list[None] = []
    with pytest.raises(CardError, match=r"has not returned within 0\.1 s"):
        within(released.wait, 0.1, lambda: signs.append(None))
    released.set()
    assert signs
