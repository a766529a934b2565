"""Sections of the rig file about cards: the keys of every driver, and those of each driver of softrig."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field, model_validator

from protocols.validation import ValidationFault, faults
from rig.config.drivers import DeviceSection, Driver, DriverRegistry, Reality
from rig.sections.quantities import Index, Positive, Word


class CardConfig(DeviceSection):
    """One data-acquisition card: the keys of every driver. A driver adds keys of its own in a subclass."""

    device: Word = Field(description="/dev/comedi0, a board name, or the mock card's name")
    sampling_hz: Positive = Field(default=1000.0, le=20_000)
    outputs: Index = Field(description="AO channels that the card has")
    inputs: Index = Field(description="AI channels that the card has")
    digital_inputs: Index = Field(default=0, description="DI channels that the card has")
    digital_outputs: Index = Field(default=0, description="DO channels that the card has")

    writes_digital: ClassVar[bool] = False
    """True for a driver whose cards are `DigitalOutputCard`s."""
    signal_units: ClassVar[tuple[str, ...] | None] = ("V",)
    """Units of the inputs and outputs; None for a card that takes every unit."""


class WiredCardConfig(CardConfig):
    """A card with a choice of how its inputs are wired."""

    reference: Literal["ground", "differential"] = Field(default="ground", description="how the inputs are wired")

    @property
    def differential(self) -> bool:
        """True if each input is a pair."""
        return self.reference == "differential"


class SampledCardConfig(WiredCardConfig):
    """A card whose inputs are sampled by its own clock or by instruction."""

    acquisition: Literal["auto", "command", "instruction"] = Field(
        default="auto", description="inputs by the card's own clock, one scan per control period, or the card's best"
    )


class ComediCardConfig(SampledCardConfig):
    """A card with a Comedi driver."""

    driver: Literal["comedi"]
    writes_digital: ClassVar[bool] = True
    emulated: bool = Field(default=False, description="the board is a virtual machine's: mark the runs as simulated")

    @property
    def reality(self) -> Reality:
        """As stated by `emulated`."""
        return Reality.EMULATED if self.emulated else Reality.REAL


class MockCardConfig(SampledCardConfig):
    """A card of the simulated bench."""

    driver: Literal["mock"]
    writes_digital: ClassVar[bool] = True
    signal_units: ClassVar[tuple[str, ...] | None] = None
    one_opener: bool = Field(default=False, description="let one process in at a time, as some drivers do")


SERIAL_BYTES = 70
"""Bytes of one sample and one acknowledgement, on the line from a serial controller."""


class SerialCardConfig(CardConfig):
    """A pressure controller on a serial port."""

    driver: Literal["serial"]
    signal_units: ClassVar[tuple[str, ...] | None] = ("bar",)
    baud: Literal[115_200, 230_400, 460_800, 500_000, 921_600, 1_000_000] = 500_000
    sampling_hz: Positive = Field(default=250.0, le=1000)

    @model_validator(mode="after")
    def _line_is_fast_enough(self) -> SerialCardConfig:
        most = self.baud / 10 / SERIAL_BYTES
        if self.sampling_hz > most:
            faults([ValidationFault(("sampling_hz",), f"at most {most:.0f} Hz at {self.baud} baud")])
        return self


class NidaqmxCardConfig(WiredCardConfig):
    """A card with an NI-DAQmx driver."""

    driver: Literal["nidaqmx"]


_KEPT = "outputs keep their values; the watchdog writes the safe state"
CARD_DRIVERS = DriverRegistry(
    "cards",
    CardConfig,
    {
        "comedi": Driver(
            ComediCardConfig,
            "rig.hardware.cards.comedi:ComediCard",
            "cards with a Comedi driver (Linux), such as PCI-1716",
            _KEPT,
            examine="rig.doctor.cards:examine_comedi",
            needs="rig.hardware.cards.comedi_device:require",
        ),
        "serial": Driver(
            SerialCardConfig,
            "rig.hardware.cards.serial:SerialCard",
            "a pressure controller on a serial port, such as an Arduino",
            "the controller vents by itself after some 50 ms without a command",
        ),
        "nidaqmx": Driver(
            NidaqmxCardConfig,
            "rig.hardware.cards.ni:NidaqmxCard",
            "NI-DAQmx devices (softrig[nidaqmx]); not tried on a device",
            _KEPT,
            examine="rig.doctor.ni:examine_nidaqmx",
            needs="rig.hardware.cards.ni:require",
        ),
        "mock": Driver(
            MockCardConfig,
            "rig.simulator.mock_card:MockCard",
            "a card of the simulated bench",
            _KEPT,
            simulated=True,
        ),
    },
    has_outputs=True,
)

if TYPE_CHECKING:
    AnyCard = CardConfig
else:
    AnyCard = CARD_DRIVERS.section(writes_digital=True, signal_units=None)
    """A card of the rig file, by the model of its driver."""
