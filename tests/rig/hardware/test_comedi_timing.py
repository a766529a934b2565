"""The choice of the acquisition command by the triggers of a card."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.hardware.cards.comedi_device import CommandTiming, Trigger, channel_lists, timings

NOW, FOLLOW, TIMER = Trigger.NOW, Trigger.FOLLOW, Trigger.TIMER


def test_a_card_of_the_171x_family_converts_without_pause() -> None:
    """scan_begin FOLLOW and convert TIMER are all it has: three channels at 1 kHz are 3000 conversions a second."""
    (timing,) = timings(FOLLOW, TIMER, 3, 1_000_000)
    assert timing == CommandTiming(FOLLOW, 0, TIMER, 333_333)
    assert timing.period_ns(3) == pytest.approx(1_000_000, abs=3)


def test_a_card_that_converts_all_channels_at_once_does_so() -> None:
    best, *_ = timings(TIMER | FOLLOW, NOW | TIMER, 3, 1_000_000)
    assert best == CommandTiming(TIMER, 1_000_000, NOW, 0)


def test_a_card_with_two_clocks_leaves_the_multiplexer_time_to_settle() -> None:
    best, *_ = timings(TIMER | FOLLOW, TIMER, 4, 1_000_000)
    assert best == CommandTiming(TIMER, 1_000_000, TIMER, 125_000)


@pytest.mark.parametrize(("scan_begin", "convert"), [(FOLLOW, NOW), (Trigger(0), TIMER), (TIMER, Trigger(0))])
def test_a_card_without_a_clock_for_its_inputs_is_given_no_command(scan_begin: Trigger, convert: Trigger) -> None:
    assert timings(scan_begin, convert, 2, 1_000_000) == ()


triggers = st.integers(0, 7).map(
    lambda bits: Trigger((NOW * (bits & 1)) | (FOLLOW * (bits >> 1 & 1)) | (TIMER * (bits >> 2)))
)


@given(triggers, triggers, st.integers(1, 16), st.integers(100_000, 10**9))
def test_every_offer_uses_triggers_that_the_card_has_and_keeps_the_period(
    scan_begin: Trigger, convert: Trigger, channels: int, period_ns: int
) -> None:
    for timing in timings(scan_begin, convert, channels, period_ns):
        assert timing.scan_begin in scan_begin
        assert timing.convert in convert
        assert abs(timing.period_ns(channels) - period_ns) < channels
        assert timing.convert_ns * channels <= period_ns


@given(st.lists(st.integers(0, 15), min_size=1, max_size=8, unique=True).map(tuple), st.booleans())
def test_every_list_of_channels_holds_all_that_are_wanted(wanted: tuple[int, ...], differential: bool) -> None:
    shortest, *others = channel_lists(wanted, differential=differential)
    assert shortest == wanted
    for channels in others:
        assert set(wanted) <= set(channels)
        assert len({b - a for a, b in pairwise(channels)}) <= 1


def test_gaps_are_filled_for_cards_that_only_count_upwards() -> None:
    assert channel_lists((5, 2)) == ((5, 2), (2, 3, 4, 5))
    assert channel_lists((0, 1, 2)) == ((0, 1, 2),)
    assert channel_lists((0, 4), differential=True) == ((0, 4), (0, 2, 4))
