"""Metering of flow by a voltage: what a valve states of it, and what a calibration finds."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from protocols.validation import ValidationFault


class FlowCurve(Protocol):
    """The flow curve of a valve, as stated in a rig file or found by a calibration."""

    @property
    def flow_curve_V(self) -> tuple[float, ...]:
        """Voltages from the closed valve."""

    @property
    def flow_curve_percent(self) -> tuple[float, ...]:
        """Per cent of the full flow at these voltages."""

    @property
    def dead_zone_V(self) -> float:
        """Half width of the dead zone."""


class MeasuredFlow(FlowCurve, Protocol):
    """What a sweep of the voltage found of one valve."""

    @property
    def closed_V(self) -> float:
        """The voltage in the middle of the dead zone."""

    @property
    def full_flow_l_min(self) -> float:
        """Normal litres per minute fully open at 6 -> 5 bar gauge."""


@dataclass(frozen=True)
class FlowMetering:
    """How a valve meters flow, as stated: what `rig calibrate pressure` sweeps and fits.

    `closed_v` lies between `low_v` and `high_v`; `fill_sign` is +1 where a higher voltage fills. `curve_v` (n,) from
    the closed valve opens `curve_percent` (n,) of `full_flow_l_min` at 6 -> 5 bar; `dead_zone_v` is the half width of
    the dead zone. `supply_pa` is absolute; `critical_ratio` is b of ISO 6358.
    """

    closed_v: float
    low_v: float
    high_v: float
    fill_sign: float
    dead_zone_v: float
    curve_v: tuple[float, ...]
    curve_percent: tuple[float, ...]
    full_flow_l_min: float
    supply_pa: float
    critical_ratio: float


def flow_curve_faults(valve: FlowCurve) -> Iterator[ValidationFault]:
    """Yield the faults of a stated or calibrated flow curve; paths start at the valve's section."""
    volts, percent = valve.flow_curve_V, valve.flow_curve_percent
    if len(volts) != len(percent):
        expected = f"{len(volts)} values, as many as flow_curve_V has, not {len(percent)}"
        yield ValidationFault(("flow_curve_percent",), expected)
    for name, values in (("flow_curve_V", volts), ("flow_curve_percent", percent)):
        if values[0] != 0:
            yield ValidationFault((name, 0), "0: the curve begins at the closed valve")
        for i, (a, b) in enumerate(itertools.pairwise(values)):
            if b <= a:
                yield ValidationFault((name, i + 1), f"more than the value before, {a:g}: the curve must rise")
    if percent[-1] > 100:
        yield ValidationFault(("flow_curve_percent", len(percent) - 1), "at most 100 (% of full flow)")
    if valve.dead_zone_V >= volts[-1]:
        yield ValidationFault(("dead_zone_V",), f"less than the end of flow_curve_V, {volts[-1]:g} V")
