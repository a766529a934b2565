"""The safe state of the valves: what it is, and the one way to write it, to read it back and to compare.

`armed` writes it on every exit of what drives the valves: control, virtual time and calibrations. Watchdog,
supervisor and observer write it by `RigSafeState` when control cannot, and `rig vent` by `open_safe_state`.
`rig.hardware.vent_verification` then confirms it by the pressures.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from rig.config.bench import BenchConfig
from rig.hardware.cards.base import Card, CardBusyError, CardError, DigitalOutputCard, card_setup, open_cards
from rig.hardware.driver_calls import as_error, release
from rig.valves.base import ValveSection

UNSAFE = "the safe state could not be written, shut the air off by hand"
"""Prefix of the message of a failed safe state."""
WRITE_ATTEMPTS = 10
"""Attempts to write a safe state before the card counts as failed."""
READBACK_TOLERANCE = 1 / 2000
"""Of the output's range: two counts of a 12-bit card."""
RETRY_S = 0.002
"""Pause between attempts to write the safe state: shorter than a control period."""


@dataclass(frozen=True)
class SafeOutputs:
    """The safe outputs (V,) of valves, each in its unit.

    `held` closes the valves whose pressure the rig file holds, and vents the others; `vented` vents all. `tolerance` is
    the largest deviation of a read-back.
    """

    held: NDArray[np.float64]
    vented: NDArray[np.float64]
    tolerance: NDArray[np.float64]

    @classmethod
    def of(cls, valves: Sequence[ValveSection]) -> SafeOutputs:
        """The safe outputs of these valves."""
        held = [
            valve.closed_output if valve.safe_state == "hold" and valve.closed_output is not None else valve.vent_output
            for valve in valves
        ]
        spans = [high - low for low, high in (valve.output_range for valve in valves)]
        vented = [valve.vent_output for valve in valves]
        return cls(np.array(held), np.array(vented), np.array(spans) * READBACK_TOLERANCE)

    def values(self, *, vent: bool = False) -> NDArray[np.float64]:
        """The outputs to write (V,); `vent` also vents held valves."""
        return self.vented if vent else self.held

    @property
    def holds(self) -> NDArray[np.bool_]:
        """The valves (V,) that the safe state does not vent."""
        return np.asarray(self.held != self.vented)

    def departed(self, stands: NDArray[np.float64], tolerance: float | None = None) -> NDArray[np.bool_]:
        """The valves (V,) that are neither safe nor vented; without a read-back (NaN) none is."""
        allowed = self.tolerance if tolerance is None else tolerance
        return np.asarray(np.minimum(np.abs(stands - self.held), np.abs(stands - self.vented)) > allowed)


def armed_sentence(unverified: int) -> str:
    """What arming did, with the number of cards without read-back."""
    if not unverified:
        return "armed: the safe state was written and read back"
    return f"armed: the safe state was written, but not read back: {unverified} card(s) cannot read their outputs back"


class SafeState:
    """The safe state of open cards. Methods may raise `CardError`."""

    def __init__(self, config: BenchConfig, cards: Mapping[str, Card]) -> None:
        """`cards` are open, by their names in the rig, set up by `card_setup`; they may be some of the rig's."""
        self._cards, self._valves = cards, config.valves
        self.outputs = SafeOutputs.of(config.valves)
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
        outputs = self.outputs.values(vent=vent)
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
        outputs = self.outputs.values(vent=vent)
        for i in sorted(i for column in self.columns.values() for i in column):
            valve, safe = self._valves[i], outputs[i]
            if abs(stands[i] - safe) > self.outputs.tolerance[i]:
                unit = valve.output_unit
                raise CardError(
                    f"valve {i + 1} (card {valve.card}, output {valve.channel}) reads back "
                    f"{stands[i]:.3f} {unit} instead of the commanded {safe:.3f} {unit}: check that nothing else "
                    "drives the card"
                )
        return tuple(name for name, column in self.columns.items() if np.isnan(stands[column]).any())

    @contextmanager
    def armed(self, vent: Callable[[], bool], written: Callable[[], None]) -> Iterator[tuple[str, ...]]:
        """Arm, and write the safe state on every exit: the one way from moving valves to safe ones.

        Yields what `arm` returns. At the exit `vent` says whether held valves vent, too, and `written` is called once
        the safe state is written; a CardError of it counts as a failure of the safe state.

        Raises:
            CardError: the cards cannot be armed; or the safe state has failed, after what ended the block.
        """
        ended: BaseException | None = None
        try:
            yield self.arm()
        except BaseException as error:
            ended = error
            raise
        finally:
            try:
                self.make_safe(vent=vent())
                written()
            except CardError as error:
                raise CardError(combined_fault(str(ended or ""), str(error))) from ended

    def readback(self) -> NDArray[np.float64]:
        """The outputs (V,), NaN where a card has no read-back."""
        outputs = np.full(len(self._valves), np.nan)
        for name, column in self.columns.items():
            with as_error(CardError, f"card {name} cannot be read back"):
                outputs[column] = self._cards[name].readback()
        return outputs

    def departure(self) -> str:
        """Message about a valve that is neither safe nor vented; empty if there is none or the cards have no read-back.

        Raises:
            CardError: a card cannot be read back.
        """
        stands = self.readback()
        for i in np.flatnonzero(self.outputs.departed(stands)).tolist():
            return f"valve {i + 1} stands at {stands[i]:.3f} {self._valves[i].output_unit}"
        return ""

    def close(self) -> None:
        """Release every card; the outputs keep their values."""
        release(self._cards.values())


def open_safe_state(config: BenchConfig, *names: str) -> SafeState:
    """Open cards of a rig for their outputs only; control may use the inputs of the same cards.

    Raises:
        CardError: a card cannot be opened.
    """
    setups = (replace(card_setup(config, name), inputs=(), digital_inputs=()) for name in names)
    return SafeState(config, open_cards(config, setups))


def cards_with_outputs(config: BenchConfig) -> tuple[str, ...]:
    """Names of the cards that drive valves or trigger cameras."""
    setups = {name: card_setup(config, name) for name in config.cards}
    return tuple(name for name, setup in setups.items() if setup.outputs or setup.digital_outputs)


def combined_fault(reason: str, failure: str) -> str:
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


class RigSafeState:
    """The safe state of a rig that another process drives: what the watchdog, the supervisor and the observer use.

    Each call opens the cards that have outputs and closes them again, unless `keep_open` has kept them.
    """

    def __init__(self, config: BenchConfig) -> None:
        self._config = config
        self._kept: SafeState | None = None

    def keep_open(self) -> None:
        """Keep the cards open, if two processes can have them at once; control must not have opened them yet.

        A card that admits one process only is open in control: it can be written only once control is dead.

        Raises:
            CardError: a card cannot be opened at all.
        """
        names = cards_with_outputs(self._config)
        kept = open_safe_state(self._config, *names)
        try:
            open_safe_state(self._config, *names).close()
        except CardBusyError:
            kept.close()
        else:
            self._kept = kept

    @property
    def kept_open(self) -> bool:
        """True if the cards can be written while control has them open."""
        return self._kept is not None

    def make_safe(self, *, vent: bool) -> None:
        """Write the safe state of every card, also if another card fails.

        Raises:
            CardError: one or more cards cannot be opened or written.
        """
        if self._kept is not None:
            self._kept.make_safe(vent=vent)
            return
        failures: list[CardError] = []
        for name in cards_with_outputs(self._config):
            try:
                with closing(open_safe_state(self._config, name)) as card:
                    card.make_safe(vent=vent)
            except CardError as error:
                failures.append(error)
        if len(failures) == 1:
            raise failures[0]
        if failures:
            raise CardError("; ".join(map(str, failures)))

    def departure(self) -> str:
        """Message about a valve that is neither safe nor vented.

        Empty if there is none, or if a card cannot be opened or has no read-back.
        """
        for name in cards_with_outputs(self._config):
            with suppress(CardError), closing(open_safe_state(self._config, name)) as card:
                if departure := card.departure():
                    return departure
        return ""

    def close(self) -> None:
        """Release the cards; the outputs keep their values."""
        if self._kept is not None:
            self._kept.close()


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
