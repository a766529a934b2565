"""The interface of a data-acquisition card, and how the cards of a rig are set up and opened.

What a card reads and writes is in the unit of its sensors and valves: volts, or bar for a device on a bus. The
conversion to pressure belongs to the rig (`rig.config.schema`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from rig.config.bench import BenchConfig
from rig.config.card_sections import CardConfig
from rig.hardware.cards.scan_clock import ScanClock
from rig.hardware.driver_calls import as_error, release


class CardError(Exception):
    """The card could not be opened, read or written: `what` is wrong, and the `remedy` if there is one."""

    def __init__(self, what: str, remedy: str = "") -> None:
        super().__init__(f"{what}: {remedy}" if remedy else what)
        self.what = what
        self.remedy = remedy


class AbsentCardError(CardError):
    """A simulated card that does not exist: no simulator runs behind it."""


class CardBusyError(CardError):
    """Another process has opened a card that allows one process only; `holders` are those visible to this user."""

    def __init__(self, what: str, holders: tuple[int, ...]) -> None:
        by = f" by process {', '.join(map(str, holders))}" if holders else ""
        super().__init__(f"{what} admits one process at a time and is open already{by}", "end that process")
        self.holders = holders


@dataclass(frozen=True)
class Channel:
    """One channel: its number on the card and the range it is used with, in the unit of the sensor or valve."""

    number: int
    low: float
    high: float


@dataclass(frozen=True)
class CardSetup:
    """The setup of one card. `inputs` and `outputs` define the order of the columns.

    `digital_inputs` are channels of digital inputs; only a `DigitalInputCard` can have any. `digital_outputs` are those
    of digital outputs, which only a `DigitalOutputCard` can have.
    `section` is that of the rig file, with the options of the driver. `by_instruction`: one scan per read, even if the
    card could sample by its own clock.
    """

    name: str
    device: str
    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    sampling_hz: float
    section: Any = None
    digital_inputs: tuple[int, ...] = ()
    digital_outputs: tuple[int, ...] = ()
    by_instruction: bool = False

    def clipped(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values of the outputs, each clipped to the range of its channel. Raises CardError: one is not finite."""
        if not np.all(np.isfinite(values)):
            raise CardError(f"card {self.device} cannot set its outputs to {values.tolist()}; nothing was written")
        low, high = [one.low for one in self.outputs], [one.high for one in self.outputs]
        return np.asarray(np.clip(values, low, high))


@dataclass(frozen=True)
class Scans:
    """Input scans taken since the last read: `t_ns` (n,) and `signals` (n, inputs), oldest first; `lost` by overrun.

    `damaged`: lines between computer and card that were damaged, and therefore dropped; 0 without such a line.
    `late_ns`: by how much the process that simulates the card is behind CLOCK_MONOTONIC; 0 for hardware.
    """

    t_ns: NDArray[np.int64]
    signals: NDArray[np.float64]
    lost: int = 0
    late_ns: int = 0
    damaged: int = 0

    @classmethod
    def none(cls, inputs: int) -> Scans:
        """No scans of so many inputs."""
        return cls(np.empty(0, np.int64), np.empty((0, inputs)))


@runtime_checkable
class SelfClockedCard(Protocol):
    """A card that may have its own sampling clock."""

    @property
    def clock(self) -> ScanClock | None:
        """The clock that gives the times of its scans; None if the card does not sample by its own clock."""


@runtime_checkable
class DigitalInputCard(Protocol):
    """A card that has digital inputs."""

    def read_digital(self) -> NDArray[np.bool_]:
        """Return whether each of `CardSetup.digital_inputs` is high now. Raises `CardError`."""


@runtime_checkable
class DigitalOutputCard(Protocol):
    """A card that has digital outputs."""

    def write_digital(self, *, high: bool) -> None:
        """Set all of `CardSetup.digital_outputs` high or low; the others keep their levels. Raises `CardError`."""


class Card(Protocol):
    """An open card. Every method may raise `CardError`; none blocks for longer than a control period."""

    def start(self) -> None:
        """Begin sampling the inputs by the card's own clock."""

    def read(self) -> Scans:
        """Return the scans taken since the last call, possibly none."""

    def write(self, outputs: NDArray[np.float64]) -> None:
        """Set the outputs, in the order of `CardSetup.outputs`."""

    def readback(self) -> NDArray[np.float64]:
        """Return the outputs, NaN where the card has no read-back."""

    def close(self) -> None:
        """Stop sampling and release the device. The outputs keep their values."""


def card_setup(config: BenchConfig, name: str, *, by_instruction: bool = False) -> CardSetup:
    """The setup of one card of the rig.

    Its inputs are the sensors in actuator order, then the auxiliary inputs; these, valves and emergency stops are in
    the order of the rig file. Its digital outputs are those that trigger cameras.
    """
    card = config.cards[name]
    sensors = [s for s in config.sensors_by_actuator if s.card == name]
    auxiliary = [i for i in config.inputs.values() if i.card == name]
    valves = [v for v in config.valves if v.card == name]
    return CardSetup(
        name=name,
        device=card.device,
        inputs=(
            *(Channel(s.channel, *s.signal_range) for s in sensors),
            *(Channel(i.channel, *i.range_V) for i in auxiliary),
        ),
        outputs=tuple(Channel(v.channel, *v.output_range) for v in valves),
        sampling_hz=card.sampling_hz,
        section=card,
        digital_inputs=tuple(stop.channel for stop in config.emergency_stops.values() if stop.card == name),
        digital_outputs=tuple(sorted({t.channel for t in config.trigger_outputs if t.card == name})),
        by_instruction=by_instruction,
    )


def card_type(card: CardConfig) -> Callable[[CardSetup], Card]:
    """The driver of a card; loading it takes time, so a process that must react at once calls this beforehand.

    Raises:
        CardError: the driver cannot be loaded.
    """
    return card.driven_by.load()


def open_card(card: CardConfig, setup: CardSetup) -> Card:
    """Open a card. Raises CardError: the card cannot be opened, for any reason."""
    driver = card_type(card)
    with as_error(CardError, f"card {setup.name}"):
        return driver(setup)


def open_cards(config: BenchConfig, setups: Iterable[CardSetup]) -> dict[str, Card]:
    """Open cards of a rig; if one fails, release the others. Raises CardError: a card cannot be opened."""
    cards: dict[str, Card] = {}
    try:
        for setup in setups:
            cards[setup.name] = open_card(config.cards[setup.name], setup)
    except BaseException:
        release(cards.values())
        raise
    return cards
