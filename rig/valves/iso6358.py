"""Flow of air through a restriction by ISO 6358.

Flow is the volume of the air at the reference atmosphere of ISO 8778 (ANR: 1 bar, 20 °C), so a
sonic conductance C is in m3/(s Pa) and a chamber at that temperature obeys  V dp/dt = ANR_PA * flow.
The functions take and return plain floats: the regulator calls them directly, the simulator compiles them.
"""

from __future__ import annotations

import math

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
