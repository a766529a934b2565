"""Selects the triggers of a continuous input command from those that a card supports."""

from __future__ import annotations

from rig.hardware.cards.comedi_device import CommandTiming, Trigger


def timings(scan_begin: Trigger, convert: Trigger, channels: int, period_ns: int) -> tuple[CommandTiming, ...]:
    """Candidate timings to sample `channels` every `period_ns` with the triggers of a card, the best first.

    Best is a card that converts all channels at once; then one with a clock for scans beside that for conversions;
    then one that converts without pause, as the 171x family does (scan_begin FOLLOW, convert TIMER).
    """
    found = []
    if Trigger.TIMER in scan_begin:
        if Trigger.NOW in convert:
            found.append(CommandTiming(Trigger.TIMER, period_ns, Trigger.NOW, 0))
        if Trigger.TIMER in convert:
            # Half of the period: close together in time, with time for the multiplexer to settle.
            found.append(CommandTiming(Trigger.TIMER, period_ns, Trigger.TIMER, period_ns // (2 * channels)))
    if Trigger.FOLLOW in scan_begin and Trigger.TIMER in convert:
        found.append(CommandTiming(Trigger.FOLLOW, 0, Trigger.TIMER, period_ns // channels))
    return tuple(found)


def channel_lists(wanted: tuple[int, ...], *, differential: bool = False) -> tuple[tuple[int, ...], ...]:
    """Lists of channels to sample, the shortest first, each holding every channel in `wanted`.

    The second is for cards whose multiplexer only counts upwards: every channel from the lowest to the highest. Of
    differential channels these cards count the even ones only, the odd ones being the other ends.
    """
    step = 2 if differential and all(channel % 2 == 0 for channel in wanted) else 1
    consecutive = tuple(range(min(wanted), max(wanted) + 1, step))
    return (wanted,) if wanted == consecutive else (wanted, consecutive)
