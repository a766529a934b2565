"""The valve types of the rig file; one line here registers a type, another package brings one as a plug-in."""

from __future__ import annotations

from inspect import isabstract
from typing import TYPE_CHECKING, get_args

from pydantic import ConfigDict

from rig.sections.control import Control, Limits
from rig.sections.plugins import PluginError, PluginSections, Registry
from rig.valves.base import Regulator, SimulatedValve, ValveSection, ValveTruth
from rig.valves.flow import FlowValve
from rig.valves.pressure import BusValve, PressureValve

VALVE_TYPES: tuple[type[ValveSection], ...] = (
    FlowValve,
    PressureValve,
    BusValve,
)


def _checked(found: object) -> type[ValveSection]:
    if not (isinstance(found, type) and issubclass(found, ValveSection)):
        raise TypeError("not a subclass of rig.valves.base.ValveSection")
    if isabstract(found):
        raise TypeError(f"it lacks {', '.join(sorted(found.__abstractmethods__))}")
    return found


class UninstalledValve(ValveSection):
    """A valve from an archive whose type is not installed here: it has no outputs and cannot be driven."""

    model_config = ConfigDict(extra="ignore")

    @property
    def output_range(self) -> tuple[float, float]:
        raise self._uninstalled("driven")

    @property
    def vent_output(self) -> float:
        raise self._uninstalled("driven")

    def regulator(self, limits: Limits, control: Control) -> Regulator:
        raise self._uninstalled("driven")

    def simulated(self, truth: SimulatedValve) -> ValveTruth:
        raise self._uninstalled("simulated")

    def _uninstalled(self, use: str) -> PluginError:
        return PluginError(f"valve type {self.type} is not installed: this rig can be read and not {use}")


def _name_of(valve: type[ValveSection]) -> str:
    (name,) = get_args(valve.model_fields["type"].annotation)
    return str(name)


VALVES: Registry[type[ValveSection]] = Registry(
    "softrig.valves", {_name_of(valve): valve for valve in VALVE_TYPES}, _checked
)

if TYPE_CHECKING:
    Valve = ValveSection
else:
    Valve = PluginSections(VALVES, "type", ValveSection, lambda valve: valve, UninstalledValve).section
    """A valve of the rig file, of the registered type that its key `type` names."""
