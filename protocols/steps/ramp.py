"""A ramp to a level."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator
from pydantic.json_schema import SkipJsonSchema

from protocols.decimals import pa
from protocols.steps.base import (
    Actuators,
    BarEach,
    MotionStep,
    Positive,
    Seconds,
    TrajectoryBuilder,
    each,
    fits,
    levels_text,
    one_of,
)
from protocols.validation import faults
from protocols.waveforms import LinearSegment, Smooth


class Ramp(MotionStep):
    """From where the set-points stand to `to_bar`, in `duration_s` or at `rate_bar_per_s`; linear, or smooth at both
    ends.
    """

    actuators: Actuators
    to_bar: BarEach = Field(description="level at the end")
    duration_s: Seconds | SkipJsonSchema[None] = None
    rate_bar_per_s: Positive | SkipJsonSchema[None] = Field(default=None, description="of the actuator that moves most")
    shape: Literal["linear", "smooth"] = "linear"

    @model_validator(mode="after")
    def _check(self) -> Ramp:
        faults(
            fits(self.actuators, {"to_bar": self.to_bar})
            + one_of(("duration_s", "rate_bar_per_s"), (self.duration_s, self.rate_bar_per_s))
        )
        return self

    def play(self, builder: TrajectoryBuilder) -> None:
        """One segment; none if the set-points stand there already and a rate is given."""
        targets = [pa(bar) for bar in each(self.to_bar, len(self.actuators))]
        starts = builder.level_pa(self.actuators)
        duration_s = self.duration_s
        if duration_s is None:
            assert self.rate_bar_per_s is not None
            farthest = max(abs(b - a) for a, b in zip(starts, targets, strict=True))
            # A smooth ramp is steepest in its middle, 15/8 of its mean slope.
            duration_s = farthest / pa(self.rate_bar_per_s) * (1.875 if self.shape == "smooth" else 1.0)
        shape = Smooth if self.shape == "smooth" else LinearSegment
        label = self.label or "to " + levels_text(self.to_bar)
        if duration_s > 0:
            waves = [shape(a, b, duration_s) for a, b in zip(starts, targets, strict=True)]
            builder.move("ramp", label, self.actuators, duration_s, waves)
