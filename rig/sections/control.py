"""Sections of the rig file that a regulator needs: limits and gains."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from pydantic.json_schema import SkipJsonSchema

from rig.sections.base import Section
from rig.sections.quantities import Count, NonNegative, Positive

Patience = Annotated[float, Field(gt=0, le=60, allow_inf_nan=False, strict=True)]
"""How long something dangerous may last; more than a minute is a number of milliseconds."""


class Limits(Section):
    """Limits of set-points and measured values."""

    pressure_bar: Annotated[float, Field(gt=0, le=10, allow_inf_nan=False, strict=True)] = Field(
        description="highest set-point and, with its margin, highest pressure"
    )
    lowest_pressure_bar: Annotated[float, Field(ge=-1, le=0, allow_inf_nan=False, strict=True)] = Field(
        default=0.0, description="lowest set-point and, with the margin, lowest pressure; below 0 with a vacuum supply"
    )
    pressure_margin_bar: NonNegative = 0.05
    rate_bar_per_s: Positive = Field(le=100, description="fastest set-point change of a continuous segment")
    rate_margin_bar_per_s: NonNegative = Field(
        default=1.0, le=1000, description="with it, fastest change a sensor may show"
    )
    tracking_bar: Positive = Field(
        le=10, description="largest error once the set-point has been constant for tracking_s"
    )
    tracking_s: Patience
    frozen_s: Patience = Field(description="a sensor whose reading has not moved by one count for so long is dead")
    stale_s: Patience = Field(description="longest time without a sample")
    no_tip_s: Patience = Field(description="longest time without a camera frame, or without a prediction of the model")
    least_cameras: Count = Field(
        default=1, description="cameras that must deliver, if there are any; with fewer the run ends"
    )
    hung_s: Patience | SkipJsonSchema[None] = Field(
        default=None,
        description="longest silence of control before the watchdog takes the valves; default: by what is at stake",
    )
    duration_s: Positive = 4 * 3600.0


class Control(Section):
    """The regulator's rate and gains; the gains are those of a flow-metering valve."""

    rate_hz: Positive = Field(default=200.0, le=1000)
    bandwidth_hz: Positive = Field(description="closed loop, of the proportional action")
    integral_s: Positive = Field(le=100, description="integration time")
    volume_ml: Positive = Field(le=10_000, description="one chamber and its tube at rest, for the feed-forward")
