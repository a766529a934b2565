"""Flow through a flow-metering valve: ISO 6358 and the curve of the data sheet.

Flow is the volume of the air at the reference atmosphere of ISO 8778 (ANR: 1 bar, 20 °C), so a
sonic conductance C is in m3/(s Pa) and a chamber at that temperature obeys  V dp/dt = ANR_PA * flow.
The functions take and return plain floats: the regulator calls them directly, the simulator compiles them.
"""

from __future__ import annotations

import math

from rig.config.sections import FlowValve

ATMOSPHERE_PA = 101_325.0
ANR_PA = 1e5
ANR_K = 293.15
LAMINAR_RATIO = 0.995
"""Above this ratio a straight line to zero replaces the ellipse of ISO 6358, whose slope at ratio 1 is infinite."""

_DATA_SHEET_UPSTREAM_PA = 6e5 + ATMOSPHERE_PA
_DATA_SHEET_DOWNSTREAM_PA = 5e5 + ATMOSPHERE_PA


def flow_function(ratio: float, critical_ratio: float) -> float:
    """Flow divided by its choked value, for a ratio of downstream to upstream absolute pressure (ISO 6358-1).

    Zero for ratios of one and more: the caller orders the two pressures.
    """
    if ratio <= critical_ratio:
        return 1.0
    if ratio >= 1.0:
        return 0.0
    if ratio > LAMINAR_RATIO:
        edge = (LAMINAR_RATIO - critical_ratio) / (1.0 - critical_ratio)
        return math.sqrt(1.0 - edge * edge) * (1.0 - ratio) / (1.0 - LAMINAR_RATIO)
    x = (ratio - critical_ratio) / (1.0 - critical_ratio)
    return math.sqrt(1.0 - x * x)


def sonic_conductance(flow_l_min: float, critical_ratio: float) -> float:
    """Sonic conductance [m3/(s Pa)] from the flow of a data sheet at 6 -> 5 bar gauge."""
    ratio = _DATA_SHEET_DOWNSTREAM_PA / _DATA_SHEET_UPSTREAM_PA
    return flow_l_min / 60_000.0 / (_DATA_SHEET_UPSTREAM_PA * flow_function(ratio, critical_ratio))


def opening_curve(valve: FlowValve, dead_zone_v: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Volts from closed and the fraction of the full flow they open, both increasing, starting at the dead zone's edge.

    With the dead zone of the rig file, this is the curve of the data sheet without its part below the dead zone.
    Another dead zone shifts the whole curve along the voltage axis, like a spool with another overlap.
    """
    shift = dead_zone_v - valve.dead_zone_V
    pairs = [
        (v + shift, percent / 100.0)
        for v, percent in zip(valve.flow_curve_V, valve.flow_curve_percent, strict=True)
        if v > valve.dead_zone_V and percent > 0
    ]
    return (dead_zone_v, *(v for v, _ in pairs)), (0.0, *(f for _, f in pairs))


def fill_sign(valve: FlowValve) -> float:
    """+1 where a higher voltage fills the chamber, -1 where a lower one does."""
    return 1.0 if valve.fills == "above" else -1.0


def vent_v(valve: FlowValve) -> float:
    """The voltage that opens the valve to the exhaust completely."""
    return valve.range_V[0] if valve.fills == "above" else valve.range_V[1]
