"""A card under test, and what the checks of cards share."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from model.arrays import Array
from rig.config.schema import RigConfig
from rig.conformance.check import NotApplicableError
from rig.conformance.timing import DEFAULT_TIMING, CheckTiming
from rig.hardware.cards.base import Card, CardSetup, Scans, card_setup, card_type
from rig.hardware.safe_state import SafeOutputs
from rig.valves.base import ValveSection

LEAST_IDLE = 0.25
"""Shortest idle wait between two calls of a slow card, as share of the control period."""


@dataclass(frozen=True)
class CardSubject:
    """A card under test; `rig_file` is for processes that open it too, `vanish` makes the device disappear."""

    config: RigConfig
    name: str
    rig_file: Path
    vanish: Callable[[], None] | None = None
    timing: CheckTiming = DEFAULT_TIMING

    @property
    def setup(self) -> CardSetup:
        """Channels as the rig uses them."""
        return card_setup(self.config, self.name)

    @property
    def period_s(self) -> float:
        return 1.0 / self.config.control.rate_hz

    @property
    def silence_s(self) -> float:
        """Time without a write after which the device is said to vent by itself; infinite where it is not."""
        section = self.config.cards[self.name]
        silence_s = section.driven_by.silence_s
        return math.inf if silence_s is None else silence_s(section)

    def open(self, *, inputs: bool = True) -> Card:
        """Open the card as control does, or as the watchdog does."""
        setup = self.setup if inputs else replace(self.setup, inputs=())
        return card_type(self.config.cards[self.name])(setup)

    def outputs(self, fraction: float) -> Array:
        """A value for each output, all different, at about this share of the range."""
        steps = enumerate(self.setup.outputs)
        return np.array([c.low + (c.high - c.low) * min(1.0, fraction + 0.02 * i) for i, c in steps])

    def stated(self, outputs: Array) -> str:
        """Array of the outputs with their unit, for messages."""
        units = {valve.output_unit for valve in self.valves} or {"V"}
        return f"{', '.join(f'{value:.3f}' for value in outputs)} {'/'.join(sorted(units))}"

    @property
    def valves(self) -> list[ValveSection]:
        """Valves of this card, in the order of its outputs."""
        return [valve for valve in self.config.valves if valve.card == self.name]

    @property
    def safe(self) -> SafeOutputs:
        """The safe value of each output, and the largest deviation of a read-back."""
        return SafeOutputs.of(self.valves)


def needs_outputs(subject: CardSubject) -> None:
    """Raise NotApplicableError for a card without valves."""
    if not subject.setup.outputs:
        raise NotApplicableError("the rig uses no output of this card")


def settled_readback(card: Card, written: Array, subject: CardSubject) -> Array:
    """The read-back, once it is what was written, or after the time for it."""
    until = time.monotonic() + subject.timing.settled_s
    while True:
        found = card.readback()
        right = np.all(np.isnan(found) | (np.abs(found - written) <= subject.safe.tolerance))
        if right or time.monotonic() > until:
            return found
        time.sleep(0.002)


def polled(card: Card, period_s: float, duration_s: float) -> Iterator[Scans]:
    """Read once in each control period."""
    due = time.monotonic()
    until = due + duration_s
    while time.monotonic() < until:
        yield card.read()
        due = max(due + period_s, time.monotonic() + LEAST_IDLE * period_s)
        time.sleep(max(0.0, due - time.monotonic()))
