"""The valve types of the rig file; one line here registers a type."""

from __future__ import annotations

import functools
import operator
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from rig.valves.base import ValveSection
from rig.valves.flow import FlowValve
from rig.valves.pressure import PressureValve

VALVE_TYPES: tuple[type[ValveSection], ...] = (
    FlowValve,
    PressureValve,
)

if TYPE_CHECKING:
    Valve = ValveSection
else:
    Valve = Annotated[functools.reduce(operator.or_, VALVE_TYPES), Field(discriminator="type")]
    """A valve of the rig file, of the registered type that its key `type` names."""
