"""Interface of the inverse solution for a `tip` step: the set-points under which the tip follows a path."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

from protocols.arrays import Array
from protocols.tip_paths import TipPath, TipStart

HISTORY_STEP_S = 0.01
HISTORY_S = 1.0
"""Duration and sampling interval of the set-points before a motion, as part of a request."""


@dataclass(frozen=True, eq=False)
class TipRequest:
    """A path, after a lead-in of `lead_in_s`, in some coordinates (0 x, 1 y, 2 z), within a tolerance.

    The lead-in begins at `begin_s` of the protocol; `before_pa` (k, N) are the set-points every HISTORY_STEP_S up to
    then.
    """

    path: TipPath
    lead_in_s: float
    coordinates: tuple[int, ...]
    tolerance_m: float
    begin_s: float
    before_pa: Array = field(repr=False)
    weight_kg: float


@dataclass(frozen=True, eq=False)
class TipSolution:
    """Times (n,) from the beginning of the lead-in, set-points (n, N) [Pa], and the tips (n, 3) [m] at these times.

    `start` is where the lead-in begins; between the times the set-points are linear. `learned_m` (n, 3) is the
    difference between arm and model that earlier runs have shown; None without earlier runs.
    """

    times_s: Array
    pressure_pa: Array = field(repr=False)
    predicted_m: Array = field(repr=False)
    start: TipStart
    learned_m: Array | None = field(default=None, repr=False)


class TipRefusedError(Exception):
    """The rig cannot follow a path; with the value and the expectation of the message."""

    def __init__(self, found: str, expected: str) -> None:
        super().__init__(found)
        self.found, self.expected = found, expected


class TipInverse(Protocol):
    """The inverse solution of a rig."""

    def solve(self, request: TipRequest) -> TipSolution:
        """The feed-forward set-points of a path.

        Raises:
            TipRefusedError: the rig cannot follow the path.
        """
