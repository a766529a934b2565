"""A hold."""

from __future__ import annotations

from pydantic import Field, model_validator
from pydantic.json_schema import SkipJsonSchema

from protocols.decimals import pa
from protocols.steps.base import Actuators, BarEach, MotionStep, Seconds, TrajectoryBuilder, each, fits, levels_text
from protocols.validation import ValidationFault, faults


class Hold(MotionStep):
    """Stay for `duration_s`: where the set-points stand, or, with `level_bar`, at a level jumped to at once."""

    duration_s: Seconds
    actuators: Actuators | SkipJsonSchema[None] = Field(default=None, description="only with level_bar")
    level_bar: BarEach | SkipJsonSchema[None] = Field(default=None, description="only with actuators")

    @model_validator(mode="after")
    def _check(self) -> Hold:
        if (self.actuators is None) != (self.level_bar is None):
            faults([ValidationFault((), "needs actuators and level_bar, or neither")])
        faults(fits(self.actuators or (), {"level_bar": self.level_bar}))
        return self

    def play(self, builder: TrajectoryBuilder) -> None:
        if self.actuators is None or self.level_bar is None:
            builder.hold("hold", self.label or "hold", (), self.duration_s)
            return
        label = self.label or levels_text(self.level_bar)
        levels_pa = [pa(bar) for bar in each(self.level_bar, len(self.actuators))]
        builder.hold("hold", label, self.actuators, self.duration_s, levels_pa)
