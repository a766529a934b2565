"""Set-points from another program."""

from __future__ import annotations

from pydantic import Field, model_validator

from protocols.steps.base import Actuators, MotionStep, Seconds, TrajectoryBuilder, fits
from protocols.validation import faults


class Stream(MotionStep):
    """For `duration_s` another program of the same user sets the pressures of these actuators, over the control socket
    of the run. A set-point out of the rig's limits is refused. The run ends in its safe state if no set-point has come
    for `timeout_s`, or none within `connect_s` from the start of the step. Only in real time.
    """

    actuators: Actuators
    duration_s: Seconds = Field(description="for how long the other program may set the pressures")
    timeout_s: Seconds = Field(default=0.5, description="longest time between two set-points")
    connect_s: Seconds = Field(default=30.0, description="longest time to the first set-point")

    @model_validator(mode="after")
    def _check(self) -> Stream:
        faults(fits(self.actuators, {}))
        return self

    def play(self, builder: TrajectoryBuilder) -> None:
        """One segment, with constant pressures until a set-point arrives."""
        builder.stream(
            self.label or "set-points of another program",
            self.actuators,
            self.duration_s,
            self.timeout_s,
            self.connect_s,
        )
