"""The digital-to-analogue converter of a mock card."""

from __future__ import annotations

import math

from rig.hardware.cards.base import CardError


def quantised_output(value: float, low: float, high: float) -> float:
    """The value of a 16-bit output for a requested value, both in the unit of the range `low` to `high`.

    Raises:
        CardError: the value is not a number.
    """
    if not math.isfinite(value):
        raise CardError(f"{value} cannot be written")
    code = round((min(max(value, low), high) - low) / (high - low) * 65535.0)
    return low + code / 65535.0 * (high - low)
