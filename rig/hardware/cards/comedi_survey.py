"""Lists the Comedi cards of this machine and their properties, without sampling or writing."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from rig.hardware.cards.base import CardError
from rig.hardware.cards.comedi_device import Device, Subdevice, device_paths, timings


@dataclass(frozen=True)
class SubdeviceSurvey:
    """The analogue inputs or outputs of a card.

    `fastest_hz` is the highest rate of one channel by the card's own clock; None if it samples by instruction only.
    """

    channels: int
    bits: int
    ranges_v: tuple[tuple[float, float], ...]
    fastest_hz: float | None

    def __str__(self) -> str:
        ranges = ", ".join(f"{low:g} to {high:g} V" for low, high in self.ranges_v)
        own_clock = self.fastest_hz is not None
        rate = f", by its own clock up to {(self.fastest_hz or 0) / 1e3:.4g} kHz for one channel" if own_clock else ""
        return f"{self.channels} of {self.bits} bit ({ranges}){rate}"


@dataclass(frozen=True)
class ComediCardSurvey:
    """One device node: its card, or `failure`, why it cannot be queried, with the remedy.

    `subdevices` are what the card has, in its order: Comedi's short name of the kind, and how many channels.
    """

    path: str
    board: str = ""
    driver: str = ""
    subdevices: tuple[tuple[str, int], ...] = ()
    inputs: SubdeviceSurvey | None = None
    outputs: SubdeviceSurvey | None = None
    failure: str = ""
    remedy: str = ""


def survey() -> tuple[ComediCardSurvey, ...]:
    """Query every Comedi device; one that cannot be opened is listed with its failure."""
    return tuple(_look(path) for path in device_paths())


def _look(path: str) -> ComediCardSurvey:
    try:
        device = Device(path)
    except CardError as error:
        return ComediCardSurvey(path, failure=error.what, remedy=error.remedy)
    known = ComediCardSurvey(path, device.board, device.driver, device.subdevices)
    try:
        return replace(known, inputs=_lines(device.inputs), outputs=_lines(device.outputs))
    except CardError as error:
        return replace(known, failure=error.what, remedy=error.remedy)
    finally:
        device.close()


def _lines(subdevice: Subdevice | None) -> SubdeviceSurvey | None:
    if subdevice is None:
        return None
    first = subdevice.line(0, 0)
    fastest = None
    if subdevice.can_command:
        # The driver lengthens a period that is too short to its shortest.
        offers = [subdevice.prepare([first], timing) for timing in timings(*subdevice.triggers(), 1, 1)]
        periods = [offer.period_ns(1) for offer in offers if offer is not None]
        fastest = 1e9 / min(periods) if periods else None
    # A range of an external reference is in no unit.
    in_volts = tuple(span for span in subdevice.ranges(0) if not math.isnan(span[0]))
    return SubdeviceSurvey(subdevice.channels, first.max_raw.bit_length(), in_volts, fastest)
