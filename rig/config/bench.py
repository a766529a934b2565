"""The part of a rig file that opens and drives its cards: what the safe state and `rig vent` need of a rig."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from rig.config.card_sections import AnyCard
from rig.config.drivers import Reality
from rig.config.input_sections import AuxiliaryInput, EmergencyStop
from rig.config.sections import CameraTrigger, Sensor
from rig.sections.base import Section
from rig.sections.quantities import Name, Named, NamedOrNone
from rig.valves.registry import Valve


class BenchConfig(Section):
    """The cards of a rig, and what is wired to them."""

    name: Name
    cards: Named[AnyCard]
    valves: Annotated[tuple[Valve, ...], Field(min_length=1)]
    sensors: tuple[Sensor, ...] = ()
    inputs: NamedOrNone[AuxiliaryInput] = Field(
        default_factory=dict, description="quantities recorded beside the pressures"
    )
    emergency_stops: NamedOrNone[EmergencyStop] = Field(
        default_factory=dict,
        description="normally-closed contacts: one that opens ends the run and vents every chamber",
    )

    @property
    def actuators(self) -> int:
        """Number of actuators."""
        return max(actuator for valve in self.valves for actuator in valve.actuators)

    @property
    def sensors_by_actuator(self) -> list[Sensor]:
        """The pressure sensors in the order of their actuators."""
        return sorted(self.sensors, key=lambda sensor: sensor.actuator)

    @property
    def trigger_outputs(self) -> tuple[CameraTrigger, ...]:
        """The digital outputs that trigger the cameras."""
        return ()

    @property
    def has_real_valves(self) -> bool:
        """True when a card of the rig is real hardware."""
        return any(card.reality is not Reality.SIMULATED for card in self.cards.values())


class VentedBench(BenchConfig):
    """What `rig vent` needs of a rig: outputs to write, and sensors that confirm it.

    Without sensors no pressure confirms it.
    """

    triggers: tuple[CameraTrigger, ...] = ()

    @property
    def trigger_outputs(self) -> tuple[CameraTrigger, ...]:
        return self.triggers

    @classmethod
    def of(cls, config: BenchConfig) -> VentedBench:
        """The part of a whole rig."""
        return cls(
            name=config.name,
            cards=config.cards,
            valves=config.valves,
            sensors=config.sensors,
            triggers=config.trigger_outputs,
        )
