"""What softrig relies on in the times of a device that sends by itself: a camera, a tracker."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from rig.driver_contract.check import BrokenContractError

LATEST_S = 2.0
"""A time that is older than this at its arrival is on another clock."""


class Timestamped(Protocol):
    """A picture or reading: its number at the device, and its time on CLOCK_MONOTONIC [ns]."""

    @property
    def index(self) -> int: ...

    @property
    def t_ns(self) -> int: ...


def rate_and_age(items: Sequence[tuple[Timestamped, int]], kind: str, stated_hz: float, early_s: float = 0.0) -> str:
    """Check times and numbers of items, each with the time of its arrival [ns], and return rate and age as text.

    early_s: how far ahead of its arrival a time may be.

    Raises:
        BrokenContractError: times or numbers do not increase, are on another clock, or the rate is not the stated one.
    """
    t_ns = np.array([item.t_ns for item, _ in items])
    index = np.array([item.index for item, _ in items])
    age_s = np.array([arrived - item.t_ns for item, arrived in items]) * 1e-9
    if np.any(np.diff(t_ns) <= 0) or np.any(np.diff(index) <= 0):
        raise BrokenContractError(f"times or numbers of the {kind} do not increase")
    if age_s.min() < -early_s or age_s.max() > LATEST_S:
        raise BrokenContractError(f"{kind} are {age_s.min():.3f} to {age_s.max():.3f} s old at their arrival")
    rate = (index[-1] - index[0]) / ((t_ns[-1] - t_ns[0]) * 1e-9)
    if not 0.8 * stated_hz <= rate <= 1.25 * stated_hz:
        raise BrokenContractError(f"{rate:.1f} {kind}/s; the rig file says {stated_hz:g}")
    return f"{rate:.1f} {kind}/s, {np.median(age_s) * 1e3:.0f} ms old at arrival"
