"""The static map of an arm as the kernels take it."""

from __future__ import annotations

import numpy as np

from model.inverse.static_map import LARGEST_PAYLOAD_KG, StaticMap
from rig.tip_control.kernels.arguments import TipMap
from rig.tip_control.kernels.tip_map import map_of_payload


def tip_map_of(static_map: StaticMap) -> TipMap:
    """The map with the pressures' polynomials in one index, and that without payload."""
    coefficients = np.ascontiguousarray(static_map.coefficients.reshape(-1, 3 * static_map.coefficients.shape[-2]))
    return TipMap(coefficients, map_of_payload(coefficients, 0.0), static_map.limit_pa, LARGEST_PAYLOAD_KG)
