"""Making the outputs safe: the outputs of the safe state, the camera trigger low, writing and repeating.

Control, the watchdog, the supervisor, the observer, virtual time and `rig vent` all use this module.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from rig.config.bench import BenchConfig
from rig.hardware.cards.base import Card, CardBusyError, CardError, DigitalOutputCard, card_setup, open_cards
from rig.hardware.driver_calls import as_error, release

UNSAFE = "the safe state could not be written, shut the air off by hand"
"""Begin of the message of a failed safe state."""
WRITE_ATTEMPTS = 10
"""Attempts to write a safe state before the card counts as failed."""
READBACK_TOLERANCE = 1 / 2000
"""Of the output's range: two counts of a 12-bit card."""
RETRY_S = 0.002
"""Pause between attempts to write the safe state."""


def safe_outputs(config: BenchConfig, *, vent: bool = False) -> tuple[float, ...]:
    """The safe output of each valve: vented, or held where the rig file says so and `vent` is false."""
    return tuple(valve.safe_output(vent=vent) for valve in config.valves)


def armed_sentence(unverified: int) -> str:
    """What arming did, with the number of cards without read-back."""
    if not unverified:
        return "armed: the safe state was written and read back"
    return f"armed: the safe state was written, but not read back: {unverified} card(s) cannot read their outputs back"


class SafeOutputs:
    """Open cards of a rig, as outputs that can be made safe. Methods may raise `CardError`."""

    def __init__(self, config: BenchConfig, cards: Mapping[str, Card]) -> None:
        """`cards` are open, by their names in the rig, set up by `card_setup`; they may be some of the rig's."""
        self._cards, self._valves = cards, config.valves
        self.safe_outputs: NDArray[np.float64] = np.array(safe_outputs(config))
        self.vent_outputs: NDArray[np.float64] = np.array(safe_outputs(config, vent=True))
        self.output_tolerance: NDArray[np.float64] = np.array(
            [(v.output_range[1] - v.output_range[0]) * READBACK_TOLERANCE for v in config.valves]
        )
        columns = {name: [i for i, v in enumerate(self._valves) if v.card == name] for name in cards}
        self.columns = {name: column for name, column in columns.items() if column}
        """Valves of each card that has any, in the order of its outputs."""
        self._triggers = _trigger_cards(config, cards)
        self.trigger_failure = ""
        """Why the last safe state has not set the camera trigger low; empty if it has."""

    def make_safe(self, *, vent: bool = False) -> None:
        """Write the safe outputs to every card, also if another card fails; `vent` also vents held valves.

        A failed write is repeated at once, at most WRITE_ATTEMPTS times. Once the valves are safe, the camera trigger
        is set low; if that fails, `trigger_failure` says why, and the valves are safe nevertheless.

        Raises:
            CardError: one or more cards could not be written; it names each.
        """
        failures = []
        outputs = self.vent_outputs if vent else self.safe_outputs
        for name, column in self.columns.items():
            if failure := _retry(partial(self._cards[name].write, outputs[column])):
                failures.append(f"card {name}: {failure}")
        lost = {name: _retry(partial(card.write_digital, high=False)) for name, card in self._triggers.items()}
        self.trigger_failure = "; ".join(
            f"the camera trigger of card {name} could not be set low: {why}" for name, why in lost.items() if why
        )
        if failures:
            raise CardError(f"{UNSAFE}: {'; '.join(failures)}")

    def write_trigger(self, *, high: bool) -> None:
        """Set the digital outputs that trigger the cameras."""
        for card in self._triggers.values():
            card.write_digital(high=high)

    def arm(self, *, vent: bool = False) -> tuple[str, ...]:
        """Write the safe outputs as `make_safe` does, read them back and compare.

        Return the names of the cards without read-back, whose outputs are not compared.

        Raises:
            CardError: the read-back of an output differs from the written one.
        """
        self.make_safe(vent=vent)
        stands = self.readback()
        outputs = self.vent_outputs if vent else self.safe_outputs
        for i in sorted(i for column in self.columns.values() for i in column):
            valve, safe = self._valves[i], outputs[i]
            if abs(stands[i] - safe) > self.output_tolerance[i]:
                unit = valve.output_unit
                raise CardError(
                    f"valve {i + 1} (card {valve.card}, output {valve.channel}) reads back "
                    f"{stands[i]:.3f} {unit} instead of the commanded {safe:.3f} {unit}: check that nothing else "
                    "drives the card"
                )
        return tuple(name for name, column in self.columns.items() if np.isnan(stands[column]).any())

    def readback(self) -> NDArray[np.float64]:
        """The outputs (V,), NaN where a card has no read-back."""
        outputs = np.full(len(self._valves), np.nan)
        for name, column in self.columns.items():
            with as_error(CardError, f"card {name} cannot be read back"):
                outputs[column] = self._cards[name].readback()
        return outputs

    def unsafe_output(self) -> str:
        """Message about a valve that is neither safe nor vented; empty if there is none or the cards have no read-back.

        Raises:
            CardError: a card cannot be read back.
        """
        stands = self.readback()
        for i in range(len(stands)):
            known = (self.safe_outputs[i], self.vent_outputs[i])
            if all(abs(stands[i] - v) > self.output_tolerance[i] for v in known):
                return f"valve {i + 1} stands at {stands[i]:.3f} {self._valves[i].output_unit}"
        return ""

    def close(self) -> None:
        """Release every card; the outputs keep their values."""
        release(self._cards.values())


def open_outputs(config: BenchConfig, *names: str) -> SafeOutputs:
    """Open cards of a rig for their outputs only; control may use the inputs of the same cards.

    Raises:
        CardError: a card cannot be opened.
    """
    setups = (replace(card_setup(config, name), inputs=(), digital_inputs=()) for name in names)
    return SafeOutputs(config, open_cards(config, setups))


def cards_with_outputs(config: BenchConfig) -> tuple[str, ...]:
    """Names of the cards that drive valves or trigger cameras."""
    setups = {name: card_setup(config, name) for name in config.cards}
    return tuple(name for name, setup in setups.items() if setup.outputs or setup.digital_outputs)


def followed_by(reason: str, failure: str) -> str:
    """A fault and the failure that followed; a failure that repeats the fault stands for both."""
    return failure if not reason or reason in failure else f"{reason}; then {failure}"


def failure_of(write: Callable[[], None], patience_s: float = 0.0) -> str:
    """Write the safe state by `write`, again while it fails, for `patience_s`; return the failure, empty on success."""
    until = time.monotonic() + patience_s
    while True:
        try:
            write()
        except CardError as error:
            if time.monotonic() >= until:
                return str(error)
            time.sleep(RETRY_S)
        else:
            return ""


def make_safe(config: BenchConfig, *, vent: bool) -> None:
    """Open every card of a rig and write its safe state, also if another card fails.

    Raises:
        CardError: one or more cannot be opened or written.
    """
    failures: list[CardError] = []
    for name in cards_with_outputs(config):
        try:
            with closing(open_outputs(config, name)) as outputs:
                outputs.make_safe(vent=vent)
        except CardError as error:
            failures.append(error)
    if len(failures) == 1:
        raise failures[0]
    if failures:
        raise CardError("; ".join(map(str, failures)))


def unsafe_output(config: BenchConfig) -> str:
    """Open every card and return a message about a valve that is neither safe nor vented.

    Empty if there is none, or if a card cannot be opened or has no read-back.
    """
    for name in cards_with_outputs(config):
        with suppress(CardError), closing(open_outputs(config, name)) as outputs:
            if off := outputs.unsafe_output():
                return off
    return ""


class WatchdogOutputs:
    """Cards with outputs, open for writing; if one allows one process only, all are opened when they are needed.

    Such a card is open in control, so the watchdog can write only once control is dead.
    """

    def __init__(self, config: BenchConfig) -> None:
        """Test whether two processes can open the cards at once; control must not have opened them yet.

        Raises:
            CardError: a card cannot be opened at all.
        """
        self._config = config
        names = cards_with_outputs(config)
        outputs = open_outputs(config, *names)
        self._outputs: SafeOutputs | None = outputs
        try:
            open_outputs(config, *names).close()
        except CardBusyError:
            outputs.close()
            self._outputs = None

    @property
    def shared(self) -> bool:
        """True if the cards can be written while control has them open."""
        return self._outputs is not None

    def make_safe(self, *, vent: bool) -> None:
        """Write the safe state. Raises CardError: a card cannot be opened or written."""
        if self._outputs is not None:
            self._outputs.make_safe(vent=vent)
            return
        make_safe(self._config, vent=vent)

    def close(self) -> None:
        """Release the cards; the outputs keep their values."""
        if self._outputs is not None:
            self._outputs.close()


def _trigger_cards(config: BenchConfig, cards: Mapping[str, Card]) -> dict[str, DigitalOutputCard]:
    """The open cards that trigger cameras. Raises CardError for a driver that writes no digital outputs."""
    found: dict[str, DigitalOutputCard] = {}
    for name, card in cards.items():
        if not card_setup(config, name).digital_outputs:
            continue
        if not isinstance(card, DigitalOutputCard):
            driver = config.cards[name].driver
            raise CardError(f"card {name} triggers cameras, and driver {driver} writes no digital outputs")
        found[name] = card
    return found


def _retry(write: Callable[[], None]) -> str:
    """Write with retries; return the reason of the failure, empty on success."""
    failure = ""
    for _ in range(WRITE_ATTEMPTS):
        try:
            write()
        except Exception as error:  # one card must not prevent the safe state of the others
            failure = str(error)
        else:
            return ""
    return failure
