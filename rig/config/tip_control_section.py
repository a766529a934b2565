"""Section of the rig file for tip control."""

from __future__ import annotations

import re
from typing import Annotated

from pydantic import Field, field_validator

from rig.config.tip_controllers import CONTROLLERS, FEED_FORWARD, KNOWN
from rig.sections.base import Section
from rig.sections.quantities import Word

_CLASS = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")


class TipControlSection(Section):
    """How the tip follows the reference of a protocol's `tip` steps."""

    controller: Word = Field(default=FEED_FORWARD, description=f"{KNOWN}, or package:Class")
    delay_ms: Annotated[float, Field(gt=0, le=500, allow_inf_nan=False, strict=True)] = Field(
        default=50.0, description="from the exposure of a frame to the plan that it leads to"
    )
    pressure_lag_ms: Annotated[float, Field(ge=0, le=500, allow_inf_nan=False, strict=True)] = Field(
        default=10.0, description="from a moving set-point to the pressure in the chamber"
    )

    @field_validator("controller")
    @classmethod
    def _known(cls, name: str) -> str:
        if name in (FEED_FORWARD, *CONTROLLERS) or _CLASS.fullmatch(name):
            return name
        raise ValueError(f"one of {KNOWN}, or package:Class of your own")
