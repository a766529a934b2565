"""Steps that move or hold the pressures, or let another program set them."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field, model_validator
from pydantic.json_schema import SkipJsonSchema

from protocols.decimals import levels_bar, pa, stair_count, uneven_stairs
from protocols.steps.base import (
    Actuators,
    AmplitudeEach,
    Bar,
    BarAbove,
    BarEach,
    MotionStep,
    NumberEach,
    Positive,
    PositiveEach,
    PressureStep,
    Seconds,
    SecondsOrNone,
    each,
    fits,
    levels_text,
    one_of,
)
from protocols.trajectory_builder import TrajectoryBuilder
from protocols.validation import ValidationFault, faults
from protocols.waveforms import LinearSegment, Sinusoid, SinusoidLeadIn, Smooth

CONNECT_SHARE = 0.9
"""Share of the step by which the first set-point must have come: a step without one must not end unnoticed."""


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


class Ramp(PressureStep):
    """From where the set-points stand to `to_bar`, in `duration_s` or at `rate_bar_per_s`; linear, or smooth at both
    ends.
    """

    to_bar: BarEach = Field(description="level at the end")
    duration_s: Seconds | SkipJsonSchema[None] = None
    rate_bar_per_s: Positive | SkipJsonSchema[None] = Field(default=None, description="of the actuator that moves most")
    shape: Literal["linear", "smooth"] = "linear"

    def faults(self) -> list[ValidationFault]:
        return super().faults() + one_of(("duration_s", "rate_bar_per_s"), (self.duration_s, self.rate_bar_per_s))

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


class Staircase(PressureStep):
    """Levels from `start_bar` to `stop_bar`, both included, `step_bar` apart, each held for `dwell_s`; upwards or
    downwards. A new level is jumped to, or approached linearly in `rise_s`.
    """

    start_bar: Bar
    stop_bar: Bar
    step_bar: BarAbove = Field(description="distance of the levels; start and stop give the direction")
    dwell_s: Seconds = Field(description="time at each level")
    rise_s: SecondsOrNone = Field(default=0.0, description="time of the change to a level; 0 jumps")

    def faults(self) -> list[ValidationFault]:
        uneven = uneven_stairs(self.start_bar, self.stop_bar, self.step_bar)
        return super().faults() + ([ValidationFault(("step_bar",), *uneven)] if uneven else [])

    def play(self, builder: TrajectoryBuilder) -> None:
        """For each level a transition, if it takes time, then the dwell."""
        for bar in levels_bar(self.start_bar, self.stop_bar, self.step_bar):
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


class Sine(PressureStep):
    """mean + amplitude sin(omega t + phase), t from the start of the sinusoid. With `lead_in_s` the set-points first
    fade smoothly from where they stand into the sinusoid; without, they jump to its first value.
    """

    mean_bar: BarEach
    amplitude_bar: AmplitudeEach
    omega_rad_s: PositiveEach | SkipJsonSchema[None] = Field(default=None, description="angular frequency")
    frequency_hz: PositiveEach | SkipJsonSchema[None] = Field(default=None, description="instead of omega_rad_s")
    period_s: PositiveEach | SkipJsonSchema[None] = Field(default=None, description="instead of omega_rad_s")
    phase_deg: NumberEach = Field(default=0.0, description="at the start")
    duration_s: Seconds | SkipJsonSchema[None] = None
    periods: Positive | SkipJsonSchema[None] = Field(default=None, description="instead of duration_s")
    lead_in_s: SecondsOrNone = 0.0

    def faults(self) -> list[ValidationFault]:
        speeds = (self.omega_rad_s, self.frequency_hz, self.period_s)
        found = super().faults() + one_of(("omega_rad_s", "frequency_hz", "period_s"), speeds)
        found += one_of(("duration_s", "periods"), (self.duration_s, self.periods))
        differ = any(isinstance(speed, tuple) and len(set(speed)) > 1 for speed in speeds)
        if self.periods is not None and differ:
            found.append(ValidationFault(("periods",), "duration_s, because the frequencies differ"))
        return found

    def play(self, builder: TrajectoryBuilder) -> None:
        """The lead-in, if it takes time, then the sinusoids."""
        count = len(self.actuators)
        if self.omega_rad_s is not None:
            omegas = each(self.omega_rad_s, count)
        elif self.period_s is not None:
            omegas = tuple(2 * math.pi / period for period in each(self.period_s, count))
        else:
            omegas = tuple(2 * math.pi * hz for hz in each(self.frequency_hz or 0.0, count))
        phases = tuple(math.radians(deg) for deg in each(self.phase_deg, count))
        means, amplitudes = each(self.mean_bar, count), each(self.amplitude_bar, count)
        sines = [
            Sinusoid(pa(mean), pa(amplitude), omega, phase)
            for mean, amplitude, omega, phase in zip(means, amplitudes, omegas, phases, strict=True)
        ]
        label = self.label or "sine"
        if self.lead_in_s > 0:
            starts = builder.level_pa(self.actuators)
            fades = [SinusoidLeadIn(start, sine, self.lead_in_s) for start, sine in zip(starts, sines, strict=True)]
            builder.move("lead-in", f"into {label}", self.actuators, self.lead_in_s, fades)
        duration_s = self.duration_s if self.duration_s is not None else (self.periods or 0) * 2 * math.pi / omegas[0]
        builder.move("sine", label, self.actuators, duration_s, sines)


class Stream(PressureStep):
    """For `duration_s` another program of the same user sets the pressures of these actuators, over the control socket
    of the run. A set-point out of the rig's limits is refused. The run ends in its safe state if no set-point has come
    for `timeout_s`, or none within `connect_s`, at most nine tenths of the step, from its start. Only in real time.
    """

    duration_s: Seconds = Field(description="for how long the other program may set the pressures")
    timeout_s: Seconds = Field(default=0.5, description="longest time between two set-points")
    connect_s: Seconds = Field(default=30.0, description="longest time to the first set-point")

    def play(self, builder: TrajectoryBuilder) -> None:
        """One segment, with constant pressures until a set-point arrives."""
        builder.stream(
            self.label or "set-points of another program",
            self.actuators,
            self.duration_s,
            self.timeout_s,
            min(self.connect_s, CONNECT_SHARE * self.duration_s),
        )
