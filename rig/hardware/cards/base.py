"""The protocol a data-acquisition card obeys.

Cards speak volts. Which volt is which bar is the rig's business (`rig.config.schema`), not the card's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray


class CardError(Exception):
    """The card could not be opened, read or written: `what` is wrong, and the `remedy` where there is one."""

    def __init__(self, what: str, remedy: str = "") -> None:
        super().__init__(f"{what}: {remedy}" if remedy else what)
        self.what = what
        self.remedy = remedy


class CardBusyError(CardError):
    """Another process has the card, which lets in one at a time; `holders` are those that this user may see."""

    def __init__(self, what: str, holders: tuple[int, ...]) -> None:
        by = f" by process {', '.join(map(str, holders))}" if holders else ""
        super().__init__(f"{what} lets in one process at a time and is open already{by}", "end that process")
        self.holders = holders


@dataclass(frozen=True)
class Channel:
    """One analogue channel: its number on the card and the voltage range it is used with."""

    number: int
    low_v: float
    high_v: float


@dataclass(frozen=True)
class CardSetup:
    """What a rig wants of one card. `inputs` and `outputs` give the order of the columns below.

    `acquisition` says whether the inputs are sampled by the card's clock (`command`), one scan per read
    (`instruction`), or by the best that the card has (`auto`). `one_opener` makes the mock let in one process at a
    time; of a real card that is found out.
    """

    name: str
    device: str
    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    sampling_hz: float
    acquisition: Literal["auto", "command", "instruction"] = "auto"
    differential: bool = False
    one_opener: bool = False


@dataclass(frozen=True)
class Scans:
    """Input scans taken since the last read: `t_ns` (n,) and `volts` (n, inputs), oldest first; `lost` by overrun.

    `late_ns`: by how much the process that simulates the card is behind the clock; 0 for hardware.
    """

    t_ns: NDArray[np.int64]
    volts: NDArray[np.float64]
    lost: int = 0
    late_ns: int = 0


@runtime_checkable
class Clocked(Protocol):
    """A card that may sample by a clock of its own."""

    @property
    def period_ns(self) -> float | None:
        """From one scan to the next as the driver rounded it; None where the card does not sample by its own clock."""

    @property
    def drift_ppm(self) -> float | None:
        """How much longer that period is by the computer's clock; None where there is none."""


class Card(Protocol):
    """An open card. Every method may raise `CardError`; none blocks for longer than a control period."""

    def start(self) -> None:
        """Begin sampling the inputs by the card's own clock."""

    def read(self) -> Scans:
        """Return the scans taken since the last call, possibly none."""

    def write(self, volts: NDArray[np.float64]) -> None:
        """Set the outputs, in the order of `CardSetup.outputs`."""

    def readback(self) -> NDArray[np.float64]:
        """Return the voltages that the outputs stand at, as far as the card can tell."""

    def close(self) -> None:
        """Stop sampling and release the device. The outputs keep their voltages."""
