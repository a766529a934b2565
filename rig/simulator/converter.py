"""The digital-to-analogue converter of a mock card."""

from __future__ import annotations

import math

from rig.hardware.cards.base import CardError


def quantised_output_v(volts: float, low: float, high: float) -> float:
    """The voltage of a 16-bit output of a range for a requested voltage.

    Raises:
        CardError: the voltage is not a number.
    """
    if not math.isfinite(volts):
        raise CardError(f"{volts} V cannot be written")
    code = round((min(max(volts, low), high) - low) / (high - low) * 65535.0)
    return low + code / 65535.0 * (high - low)
