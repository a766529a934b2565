"""Consistency of the camera triggers of a rig file with its cards, cameras, control rate and limits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from protocols.problems import closest
from protocols.validation import ValidationFault

if TYPE_CHECKING:
    from rig.config.card_sections import CardConfig
    from rig.config.sections import CameraConfig, CameraTrigger
    from rig.sections.control import Control, Limits

    Path = tuple[str | int, ...]

WHOLE = 1e-4
"""Relative tolerance for a whole number: 200 / 28.571 is 7."""
LEAST_FRAMES = 4
"""Of `no_tip_s`: no pulse is given for up to two frames before a run begins."""


def check(
    cards: Mapping[str, CardConfig | None],
    cameras: Mapping[str, CameraConfig | None],
    control: Control,
    limits: Limits,
) -> Iterator[ValidationFault]:
    """Yield what is wrong with the triggers; all cameras of a rig are triggered together, or none."""
    known = {name: camera for name, camera in cameras.items() if camera is not None}
    triggers = {name: camera.trigger for name, camera in known.items() if camera.trigger is not None}
    if not triggers:
        return
    first, lead = next(iter(triggers.items()))
    for name, camera in known.items():
        path: Path = ("cameras", name)
        trigger = camera.trigger
        if trigger is None:
            yield ValidationFault((*path, "trigger"), f"a trigger, because camera '{first}' has one: they see together")
            continue
        yield from _output((*path, "trigger"), trigger, camera, cards)
        yield from _timing(path, trigger, camera, control)
        for key, own, other in (("card", trigger.card, lead.card), ("width_ms", trigger.width_ms, lead.width_ms)):
            if own != other:
                expected = f"that of camera '{first}', {'one control period' if other is None else other}"
                yield ValidationFault((*path, "trigger", key), f"{expected}: one pulse triggers all cameras")
        if limits.no_tip_s < LEAST_FRAMES / camera.rate_hz:
            expected = f"at least {LEAST_FRAMES} frames of the triggered camera '{name}', "
            yield ValidationFault(("limits", "no_tip_s"), f"{expected}{LEAST_FRAMES / camera.rate_hz:g} s")


def _output(
    path: Path, trigger: CameraTrigger, camera: CameraConfig, cards: Mapping[str, CardConfig | None]
) -> Iterator[ValidationFault]:
    """Check that the card has the digital output."""
    if trigger.card not in cards:
        expected = f"one of the cards: {', '.join(cards)}"
        yield ValidationFault((*path, "card"), expected, closest(trigger.card, cards))
        return
    card = cards[trigger.card]
    if card is None:
        return
    if not card.writes_digital:
        expected = f"a card whose driver writes digital outputs: driver {card.driver} writes none"
        yield ValidationFault((*path, "card"), expected)
    elif camera.is_mock != card.is_mock:
        kind = "simulated" if camera.is_mock else "real"
        yield ValidationFault((*path, "card"), f"a {kind} card, because the camera is {kind}")
    elif trigger.channel >= card.digital_outputs:
        count = card.digital_outputs
        expected = "a card with `digital_outputs`" if count == 0 else f"a channel from 0 to {count - 1}"
        yield ValidationFault((*path, "channel"), f"{expected}: card '{trigger.card}' has {count or 'no'} DO channels")


def _timing(path: Path, trigger: CameraTrigger, camera: CameraConfig, control: Control) -> Iterator[ValidationFault]:
    """Check that period and width of the pulses are whole numbers of control periods."""
    cycles = control.rate_hz / camera.rate_hz
    if cycles < 2 - WHOLE:
        expected = f"at most half of control, rate_hz, {control.rate_hz / 2:g} Hz: control gives the trigger pulses"
        yield ValidationFault((*path, "rate_hz"), expected)
        return
    if abs(cycles - round(cycles)) > WHOLE * cycles:
        near = " or ".join(f"{control.rate_hz / n:.6g}" for n in (int(cycles) + 1, int(cycles)) if n >= 2)
        expected = f"a rate that divides control, rate_hz, such as {near} Hz: control gives the trigger pulses"
        yield ValidationFault((*path, "rate_hz"), expected)
        return
    if trigger.width_ms is None:
        return
    period_ms, width = 1e3 / control.rate_hz, trigger.width_ms * 1e-3 * control.rate_hz
    if round(width) < 1 or abs(width - round(width)) > WHOLE * width or round(width) >= round(cycles):
        longest = (round(cycles) - 1) * period_ms
        expected = f"whole control periods of {period_ms:g} ms, at most {longest:g} ms: less than a frame period"
        yield ValidationFault((*path, "trigger", "width_ms"), expected)
