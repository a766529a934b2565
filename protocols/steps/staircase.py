"""A staircase of levels."""

from __future__ import annotations

from pydantic import Field, model_validator

from protocols.decimals import levels_bar, pa, stair_count, uneven_stairs
from protocols.steps.base import Actuators, Bar, BarAbove, MotionStep, Seconds, SecondsOrNone, TrajectoryBuilder, fits
from protocols.validation import ValidationFault, faults
from protocols.waveforms import LinearSegment


class Staircase(MotionStep):
    """Levels from `start_bar` to `stop_bar`, both included, `step_bar` apart, each held for `dwell_s`; upwards or
    downwards. A new level is jumped to, or approached linearly in `rise_s`.
    """

    actuators: Actuators
    start_bar: Bar
    stop_bar: Bar
    step_bar: BarAbove = Field(description="distance of the levels; start and stop give the direction")
    dwell_s: Seconds = Field(description="time at each level")
    rise_s: SecondsOrNone = Field(default=0.0, description="time of the change to a level; 0 jumps")

    @model_validator(mode="after")
    def _check(self) -> Staircase:
        found = fits(self.actuators, {})
        uneven = uneven_stairs(self.start_bar, self.stop_bar, self.step_bar)
        if uneven:
            found.append(ValidationFault(("step_bar",), *uneven))
        faults(found)
        return self

    def levels_bar(self) -> tuple[float, ...]:
        """The levels, in order."""
        return levels_bar(self.start_bar, self.stop_bar, self.step_bar)

    def play(self, builder: TrajectoryBuilder) -> None:
        """For each level a transition, if it takes time, then the dwell."""
        for bar in self.levels_bar():
            target, label = pa(bar), f"{bar:g} bar"
            label = f"{self.label}, {label}" if self.label else label
            starts = builder.level_pa(self.actuators)
            if self.rise_s > 0 and any(start != target for start in starts):
                waves = [LinearSegment(start, target, self.rise_s) for start in starts]
                builder.move("rise", label, self.actuators, self.rise_s, waves)
            builder.hold("dwell", label, self.actuators, self.dwell_s, [target] * len(starts))

    @property
    def most_segments(self) -> tuple[int, tuple[str, ...]]:
        return 2 * stair_count(self.start_bar, self.stop_bar, self.step_bar), ("step_bar",)
