"""The valve types of the rig file; one line here registers a type, another package brings one as a plug-in."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rig.sections.plugins import SectionRegistry
from rig.valves.base import ValveSection
from rig.valves.flow import FlowValve
from rig.valves.pressure import BusValve, PressureValve

VALVES = SectionRegistry[ValveSection]("valves", "type", ValveSection, FlowValve, PressureValve, BusValve)

if TYPE_CHECKING:
    Valve = ValveSection
else:
    Valve = VALVES.section()
    """A valve of the rig file, of the registered type that its key `type` names."""
