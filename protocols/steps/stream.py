"""Set-points from another program."""

from __future__ import annotations

from pydantic import Field, model_validator

from protocols.steps.base import Actuators, MotionStep, Seconds, TrajectoryBuilder, fits
from protocols.validation import faults

CONNECT_SHARE = 0.9
"""Share of the step by which the first set-point must have come: a step without one must not end unnoticed."""


class Stream(MotionStep):
    """For `duration_s` another program of the same user sets the pressures of these actuators, over the control socket
    of the run. A set-point out of the rig's limits is refused. The run ends in its safe state if no set-point has come
    for `timeout_s`, or none within `connect_s`, at most nine tenths of the step, from its start. Only in real time.
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
            min(self.connect_s, CONNECT_SHARE * self.duration_s),
        )
