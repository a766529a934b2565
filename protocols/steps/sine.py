"""Sinusoids."""

from __future__ import annotations

import math

from pydantic import Field, model_validator
from pydantic.json_schema import SkipJsonSchema

from protocols.decimals import pa
from protocols.steps.base import (
    Actuators,
    AmplitudeEach,
    BarEach,
    MotionStep,
    NumberEach,
    Positive,
    PositiveEach,
    Seconds,
    SecondsOrNone,
    TrajectoryBuilder,
    each,
    fits,
    one_of,
)
from protocols.validation import ValidationFault, faults
from protocols.waveforms import Sinusoid, SinusoidLeadIn


class Sine(MotionStep):
    """mean + amplitude sin(omega t + phase), t from the start of the sinusoid. With `lead_in_s` the set-points first
    fade smoothly from where they stand into the sinusoid; without, they jump to its first value.
    """

    actuators: Actuators
    mean_bar: BarEach
    amplitude_bar: AmplitudeEach
    omega_rad_s: PositiveEach | SkipJsonSchema[None] = Field(default=None, description="angular frequency")
    frequency_hz: PositiveEach | SkipJsonSchema[None] = Field(default=None, description="instead of omega_rad_s")
    period_s: PositiveEach | SkipJsonSchema[None] = Field(default=None, description="instead of omega_rad_s")
    phase_deg: NumberEach = Field(default=0.0, description="at the start")
    duration_s: Seconds | SkipJsonSchema[None] = None
    periods: Positive | SkipJsonSchema[None] = Field(default=None, description="instead of duration_s")
    lead_in_s: SecondsOrNone = 0.0

    @model_validator(mode="after")
    def _check(self) -> Sine:
        names = ("mean_bar", "amplitude_bar", "omega_rad_s", "frequency_hz", "period_s", "phase_deg")
        found = fits(self.actuators, {name: getattr(self, name) for name in names})
        speeds = (self.omega_rad_s, self.frequency_hz, self.period_s)
        found += one_of(("omega_rad_s", "frequency_hz", "period_s"), speeds)
        found += one_of(("duration_s", "periods"), (self.duration_s, self.periods))
        differ = any(isinstance(speed, tuple) and len(set(speed)) > 1 for speed in speeds)
        if self.periods is not None and differ:
            found.append(ValidationFault(("periods",), "duration_s, because the frequencies differ"))
        faults(found)
        return self

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
