"""Pressure levels to rest at: every combination of a grid of each valve's levels, and the protocol that visits some."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from calibration.identify.data import SETTLE_S
from rig.config.schema import RigConfig

Level = tuple[float, ...]
"""Pressures [bar] of the actuators."""

ENDS_S = 1.0
"""Time at zero before the first level, and after the last one: too short for a plateau."""

# Lowest and highest level as fractions of the pressure limit: sensors are not at the foot of their scale there.
_LOWEST, _HIGHEST = 0.05, 0.95
# Steepest set-point as a fraction of the rate limit.
_STEEPEST = 0.9
# Combinations of levels that are compared, at most; and the levels of a valve, at least and at most.
_MAX_COMBINATIONS, _FEWEST, _MOST = 64, 2, 16
# Time that a level is measured for, after the arm has settled.
_MEASURED_S = 1.2
_ORDERS = 200


def levels(config: RigConfig) -> tuple[Level, ...]:
    """Every combination of the grids."""
    valves = len(config.valves)
    count = min(_MOST, max(_FEWEST, int(_MAX_COMBINATIONS ** (1 / valves) + 1e-9)))
    grid = np.linspace(_LOWEST, _HIGHEST, count) * config.limits.pressure_bar
    out = []
    for own in itertools.product(np.round(grid, 4).tolist(), repeat=valves):
        of = {actuator: bar for valve, bar in zip(config.valves, own, strict=True) for actuator in valve.actuators}
        out.append(tuple(of[k + 1] for k in range(config.actuators)))
    return tuple(out)


def level_s(config: RigConfig) -> float:
    """Time [s] that a level takes: the longest ramp, and a dwell that an identification takes for a plateau."""
    return _ramp_s(config) + SETTLE_S + _MEASURED_S


def ends_s(config: RigConfig) -> float:
    """Time [s] that a protocol takes before the first level and after the last one."""
    return 2 * ENDS_S + _ramp_s(config)


def in_order(chosen: Sequence[Level], seed: int) -> list[Level]:
    """The levels in random order, so that creep and hysteresis do not follow the pressure; equal ones are apart if they
    can be: neighbours of equal level are one plateau."""
    rng = np.random.default_rng(seed)
    orders = [rng.permutation(len(chosen)) for _ in range(_ORDERS)]

    def repeats(order: np.ndarray) -> int:
        return sum(chosen[a] == chosen[b] for a, b in itertools.pairwise(order.tolist()))

    return [chosen[k] for k in min(orders, key=repeats).tolist()]


def steps(config: RigConfig, chosen: Sequence[Level]) -> list[dict[str, Any]]:
    """Protocol steps, as in the YAML, through the levels and back to zero."""
    every, ramp_s = list(range(1, config.actuators + 1)), _ramp_s(config)
    out: list[dict[str, Any]] = [{"hold": {"actuators": every, "level_bar": 0, "duration_s": ENDS_S}}]
    for level in chosen:
        out.append({"ramp": {"actuators": every, "to_bar": list(level), "duration_s": ramp_s}})
        out.append({"hold": {"duration_s": SETTLE_S + _MEASURED_S}})
    out.append({"ramp": {"actuators": every, "to_bar": 0, "duration_s": ramp_s}})
    return [*out, {"hold": {"duration_s": ENDS_S}}]


def _ramp_s(config: RigConfig) -> float:
    limits = config.limits
    return math.ceil(100 * _HIGHEST * limits.pressure_bar / (_STEEPEST * limits.rate_bar_per_s)) / 100
