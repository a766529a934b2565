"""Blocked moves: deviations from the feed-forward at a few knots of the horizon, linear in between."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from model.arrays import Array
from runs.interpolation import interpolated

HORIZON = 12
"""Frames of the horizon."""
KNOTS = (0, 1, 2, 4, 7, 12)
"""Frames from the start of the plan at which the deviation is a variable; at the first one it is given."""


class MoveBlocking(NamedTuple):
    """Constraints and cost of the free deviations (n,), those of V valves at all knots but the first.

    `knots_s` (k,) and `frames_s` (HORIZON + 1,) are times after the start of the plan. `constraints` (m, n): pressures
    at the frames, then their changes from frame to frame. `first_weights` (HORIZON + 1,): weights of the given
    deviation at the frames. The cost of the deviations' rates has the Hessian `rate_hessian` (n, n); `rate_gradient`
    (n, V) times the given deviation is its gradient at zero.
    """

    knots_s: Array
    frames_s: Array
    constraints: Array
    first_weights: Array
    rate_hessian: Array
    rate_gradient: Array

    @classmethod
    def of(cls, valves: int, frame_s: float, rate_weight: float) -> MoveBlocking:
        """For knots that are `frame_s` times KNOTS apart; `rate_weight` is the cost of a rate of 1 bar/s [mm]."""
        knots, frames = np.array(KNOTS, dtype=np.float64), np.arange(HORIZON + 1, dtype=np.float64)
        weights = interpolated(frames, knots, np.eye(len(knots)))
        identity = np.eye(valves)
        rates = rate_weight * np.diff(np.eye(len(knots)), axis=0) / (frame_s * np.diff(knots)[:, None])
        free, given = np.kron(rates[:, 1:], identity), np.kron(rates[:, :1], identity)
        levels_and_changes = np.concatenate([weights[1:, 1:], np.diff(weights[:, 1:], axis=0)])
        return cls(
            frame_s * knots,
            frame_s * frames,
            np.kron(levels_and_changes, identity),
            np.ascontiguousarray(weights[:, 0]),
            np.ascontiguousarray(free.T @ free),
            np.ascontiguousarray(free.T @ given),
        )
