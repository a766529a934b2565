"""Sections of the rig file about inputs beside the pressures: measured quantities and emergency stops."""

# ruff: noqa: N815 - volts keep their capital, as in V and mV

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field
from pydantic.json_schema import SkipJsonSchema

from rig.sections.base import Section
from rig.sections.quantities import Index, NonNegative, Number, Positive, Triple, VoltSpan, Word


def _two_values(span: tuple[float, float]) -> tuple[float, float]:
    if span[0] == span[1]:
        raise ValueError("two different numbers")
    return span


def _some_direction(vector: Triple) -> Triple:
    if not any(vector):
        raise ValueError("a direction, not three zeros")
    return vector


class AuxiliaryInput(Section):
    """A measured quantity that is recorded beside the pressures: force, flow, temperature, strain.

    It is linear in voltage, from `span_V` to `span`. A voltage outside `span_V` by more than `margin_V` is a broken
    sensor or wire, and recorded as NaN.
    """

    card: Word
    channel: Index
    unit: Annotated[str, Field(pattern=r"^[^\s\x00-\x1f\x7f]{1,16}$")] = Field(
        description="of the quantity, such as N, l/min, degC; without spaces"
    )
    span: Annotated[tuple[Number, Number], AfterValidator(_two_values)] = Field(
        description="the quantity at the ends of span_V, in `unit`"
    )
    range_V: VoltSpan = (0.0, 10.0)
    span_V: VoltSpan = (0.0, 10.0)
    margin_V: NonNegative = 0.1
    rate_hz: Positive | SkipJsonSchema[None] = Field(
        default=None, description="new values per second, each the mean since the last; default: the control rate"
    )
    tip_force_direction: Annotated[Triple, AfterValidator(_some_direction)] | SkipJsonSchema[None] = Field(
        default=None,
        description="the input measures the force on the arm's tip along this direction of the rod-base frame: it is "
        "the tip load of the model",
    )

    def value(self, volts: NDArray[np.float64]) -> NDArray[np.float64]:
        """The quantity at voltages, in `unit`; NaN outside the span."""
        (v0, v1), (q0, q1) = self.span_V, self.span
        inside = (volts >= v0 - self.margin_V) & (volts <= v1 + self.margin_V)
        return np.where(inside, q0 + (volts - v0) * ((q1 - q0) / (v1 - v0)), np.nan)

    def volts(self, value: NDArray[np.float64]) -> NDArray[np.float64]:
        """The voltage [V] at values of the quantity, within the range of the input."""
        (v0, v1), (q0, q1) = self.span_V, self.span
        return np.clip(v0 + (value - q0) * ((v1 - v0) / (q1 - q0)), *self.range_V)


class EmergencyStop(Section):
    """A normally-closed contact at a digital input: closed, the input is high; pressed or broken, it is low."""

    card: Word
    channel: Index


class SimulatedInput(Section):
    """True value of an auxiliary input: `rest`, more with the mean pressure of the chambers and the weight on the cap.

    Without this section an input rests in the middle of its span.
    """

    rest: Number
    per_bar: Number = 0.0
    per_g: Number = 0.0
    noise: NonNegative = Field(default=0.0, description="standard deviation of one sample, in the unit of the input")
