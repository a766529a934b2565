"""Section of the rig file for tip control."""

from __future__ import annotations

import re
from typing import Annotated

from pydantic import Field, field_validator

from rig.sections.base import Section
from rig.sections.quantities import Word

TIP_CONTROLLERS = ("feed-forward", "horizon", "static-inverse", "inverse-integral")
"""Names of the tip controllers; `rig.tip_control.registry` has their classes."""

_CLASS = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")


class TipControlSection(Section):
    """How the tip follows the reference of a protocol's `tip` steps."""

    controller: Word = Field(
        default="feed-forward", description="feed-forward, horizon, static-inverse, inverse-integral, or package:Class"
    )
    delay_ms: Annotated[float, Field(gt=0, le=500, allow_inf_nan=False, strict=True)] = Field(
        default=50.0, description="from the exposure of a frame to the plan that it leads to"
    )
    pressure_lag_ms: Annotated[float, Field(ge=0, le=500, allow_inf_nan=False, strict=True)] = Field(
        default=10.0, description="from a moving set-point to the pressure in the chamber"
    )

    @field_validator("controller")
    @classmethod
    def _known(cls, name: str) -> str:
        if (name in TIP_CONTROLLERS) or _CLASS.fullmatch(name):
            return name
        raise ValueError(f"one of {', '.join(TIP_CONTROLLERS)}, or package:Class of your own")
