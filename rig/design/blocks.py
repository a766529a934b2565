"""Building blocks of a designed protocol: each starts and ends at the rest level and is within the rig's limits."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from protocols import from_steps
from rig.config.schema import RigConfig
from rig.experiment.preflight import check

BLOCK_S = 4.0
# Levels as fractions of the pressure limit: at rest, where sensors are not at the foot of their scale, and the highest.
_REST, _HIGHEST = 0.1, 0.95
# Steepest set-point as a fraction of the rate limit.
_STEEPEST = 0.9
_FREQUENCIES_HZ = (0.4, 0.8, 1.6, 3.2)
_MEANS = (0.5, 1.0)
# Sinusoids about levels: fast ones excite the first mode of an arm. A period needs so many frames of the cameras.
_FAST_HZ = (3.2, 5.0)
_FRAMES_PER_PERIOD = 4
# Levels of a valve in steps, as fractions of the way from rest to the highest level: the finest grid with at most so
# many combinations is used, the last one with more valves.
_GRIDS = ((0.0, 0.35, 0.7, 1.0), (0.0, 0.5, 1.0), (0.0, 1.0))
_MAX_COMBINATIONS = 30
# Share of the dwell that is spent at the level; the rest of it is at the rest level.
_DWELL_SHARE = 0.95
_LEAD_IN_S = 1.0
_MIN_AMPLITUDE_BAR = 0.01
# Time at rest after a sinusoid; and the factor by which an amplitude that breaks a limit shrinks.
_PAUSE_S, _SHRINK = 0.5, 0.9


@dataclass(frozen=True)
class Block:
    """Protocol steps, as in the YAML, that take `BLOCK_S`; the rest level comes before and after."""

    steps: tuple[dict[str, Any], ...]


def rest_bar(config: RigConfig) -> float:
    """The level [bar] between the blocks."""
    return round(_REST * config.limits.pressure_bar, 4)


def blocks(config: RigConfig) -> tuple[Block, ...]:
    """Every block that a rig can do: steps to combinations of levels, sinusoids in phase and in sequence, and fast
    sinusoids about the levels."""
    return tuple(itertools.chain(_steps(config), _sines(config), _sines_about_levels(config)))


def _valve_groups(config: RigConfig) -> list[tuple[tuple[int, ...], ...]]:
    valves = [tuple(valve.actuators) for valve in config.valves]
    return [group for size in range(1, len(valves) + 1) for group in itertools.combinations(valves, size)]


def _ramp_down(config: RigConfig, actuators: list[int]) -> dict[str, Any]:
    return {"ramp": {"actuators": actuators, "to_bar": rest_bar(config), "duration_s": _fall_s(config)}}


def _fall_s(config: RigConfig) -> float:
    limits = config.limits
    return round((_HIGHEST - _REST) * limits.pressure_bar / (_STEEPEST * limits.rate_bar_per_s) + 0.005, 2)


def _combinations(config: RigConfig) -> list[tuple[float, ...]]:
    """Levels of the valves, as fractions of the way from rest to the highest level; not all at rest."""
    for grid in _GRIDS:
        if len(grid) ** len(config.valves) - 1 <= _MAX_COMBINATIONS:
            break
    return list(itertools.product(grid, repeat=len(config.valves)))[1:]


def _steps(config: RigConfig) -> Iterator[Block]:
    """Up as fast as the limit allows, a dwell, and down again: all frequencies at once."""
    for combination in _combinations(config):
        to_bar = _to_bar(config, combination, _HIGHEST * config.limits.pressure_bar)
        rise_s = _rise_s(config, combination)
        dwell_s = max(BLOCK_S - rise_s - _fall_s(config), 0.1)
        high_s = round(_DWELL_SHARE * dwell_s, 3)
        block = Block(
            (
                _ramp_up(to_bar, rise_s),
                {"hold": {"duration_s": high_s}},
                _ramp_down(config, sorted(to_bar)),
                {"hold": {"duration_s": round(dwell_s - high_s, 3)}},
            )
        )
        if _is_possible(config, block):
            yield block


def _to_bar(config: RigConfig, combination: tuple[float, ...], highest_bar: float) -> dict[int, float]:
    """Levels [bar] of the actuators that leave rest, between rest and the highest one."""
    rest = rest_bar(config)
    return {
        actuator: round(rest + fraction * (highest_bar - rest), 4)
        for valve, fraction in zip(config.valves, combination, strict=True)
        for actuator in valve.actuators
        if fraction
    }


def _rise_s(config: RigConfig, combination: tuple[float, ...]) -> float:
    return round(max(combination) * _fall_s(config) + 0.005, 2)


def _ramp_up(to_bar: dict[int, float], rise_s: float) -> dict[str, Any]:
    actuators = sorted(to_bar)
    return {"ramp": {"actuators": actuators, "to_bar": [to_bar[one] for one in actuators], "duration_s": rise_s}}


def _sines(config: RigConfig) -> Iterator[Block]:
    """Sinusoids as large as the limits allow; the valves in phase, and one after the other."""
    limits, rest = config.limits, rest_bar(config)
    span = _HIGHEST * limits.pressure_bar - rest
    for group, share, hertz in itertools.product(_valve_groups(config), _MEANS, _FREQUENCIES_HZ):
        largest = min(share * span / 2, _STEEPEST * limits.rate_bar_per_s / (2 * math.pi * hertz))
        for spread in (0.0, 120.0) if len(group) > 1 else (0.0,):
            amplitude = largest
            while amplitude >= _MIN_AMPLITUDE_BAR:
                block = _sine(config, group, rest + share * span / 2, amplitude, hertz, spread)
                if _is_possible(config, block):
                    yield block
                    break
                amplitude *= _SHRINK


def _sines_about_levels(config: RigConfig) -> Iterator[Block]:
    """Up to a combination of levels, a fast sinusoid about them, and down again: bent poses and motion at once."""
    limits = config.limits
    fastest_hz = min(config.control.bandwidth_hz, config.observation_hz / _FRAMES_PER_PERIOD)
    for hertz, combination in itertools.product((one for one in _FAST_HZ if one <= fastest_hz), _combinations(config)):
        amplitude = round(_STEEPEST * limits.rate_bar_per_s / (2 * math.pi * hertz), 4)
        to_bar = _to_bar(config, combination, _HIGHEST * limits.pressure_bar - amplitude)
        rise_s, fall_s = _rise_s(config, combination), _fall_s(config)
        periods = math.floor((BLOCK_S - rise_s - fall_s) * hertz)
        if periods < 1 or min(to_bar.values()) < amplitude:
            continue
        actuators = sorted(to_bar)
        sine = {
            "actuators": actuators,
            "mean_bar": [to_bar[one] for one in actuators],
            "amplitude_bar": amplitude,
            "frequency_hz": hertz,
            "periods": periods,
        }
        left_s = round(BLOCK_S - rise_s - fall_s - periods / hertz, 6)
        rest = ({"hold": {"duration_s": left_s}},) if left_s > 0 else ()
        block = Block((_ramp_up(to_bar, rise_s), {"sine": sine}, _ramp_down(config, actuators), *rest))
        if _is_possible(config, block):
            yield block


def _sine(
    config: RigConfig,
    group: tuple[tuple[int, ...], ...],
    mean: float,
    amplitude: float,
    hertz: float,
    spread_deg: float,
) -> Block:
    actuators = [actuator for valve in group for actuator in valve]
    sine = {
        "actuators": actuators,
        "mean_bar": round(mean, 4),
        "amplitude_bar": round(amplitude, 4),
        "frequency_hz": hertz,
        "phase_deg": [spread_deg * k for k, valve in enumerate(group) for _ in valve],
        "duration_s": round(max(BLOCK_S - _LEAD_IN_S - _fall_s(config) - _PAUSE_S, 0.0), 2),
        "lead_in_s": _LEAD_IN_S,
    }
    return Block(({"sine": sine}, _ramp_down(config, sorted(actuators)), {"hold": {"duration_s": _PAUSE_S}}))


def _is_possible(config: RigConfig, block: Block) -> bool:
    """Whether a block takes `BLOCK_S` and keeps the limits, from the rest level on."""
    every = list(range(1, config.actuators + 1))
    start = {"hold": {"actuators": every, "level_bar": rest_bar(config), "duration_s": 1}}
    trajectory = from_steps("block", [start, *block.steps]).expand(config.actuators)
    return abs(trajectory.duration_s - 1 - BLOCK_S) < 1e-6 and not check(config, trajectory)
