"""Repeatability of an arm: how far its tip is from itself when the same pressures return."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.identify.observations.poses import Poses
from model.arrays import Array

# A state is held while no pressure changes by more than this share of its range over this time, and is its end.
_STILL_SHARE, _HELD_S = 0.03, 1.0
# States repeat if their pressures differ by less than the first share, after one that differs by more than the second.
_SAME_SHARE, _AWAY_SHARE = 0.05, 0.15


@dataclass(frozen=True)
class Repeatability:
    """Standard deviation [m] of the tip's distance from its mean over repeated states, and their number."""

    rms_m: float
    states: int
    repeats: int


def repeatability(data: Sequence[Poses]) -> Repeatability | None:
    """The scatter within runs of states whose pressures return after others; None if none return.

    No model without the memory of an arm predicts its tip better. Runs under a measured wrench or under weights that
    change do not count.
    """
    squares, freedom, states, repeats = 0.0, 0, 0, 0
    for poses in data:
        if np.ptp(poses.weight_kg) > 0 or poses.wrench.any():
            continue
        pressure, tip = _held_states(poses)
        scale = float(np.ptp(poses.pressure_pa, axis=0).max(initial=0.0))
        for group in _groups(pressure, scale):
            if len(group) > 1:
                gap = tip[group] - tip[group].mean(axis=0)
                squares += float((gap**2).sum())
                freedom += len(group) - 1
                states, repeats = states + 1, repeats + len(group)
    return Repeatability(float(np.sqrt(squares / freedom)), states, repeats) if freedom else None


def _held_states(poses: Poses) -> tuple[Array, Array]:
    """Pressures (S, N) and tips (S, 3) at the end of each state that is held; a plateau is one."""
    seen = poses.has_tip
    pressure, tip, time_s = poses.pressure_pa[seen], poses.tip_m[seen], poses.time_s[seen]
    if not poses.in_sequence:
        return pressure, tip
    scale = float(np.ptp(pressure, axis=0).max(initial=0.0))
    first = np.searchsorted(time_s, time_s - _HELD_S)
    still = np.array(
        [
            time_s[k] - time_s[0] >= _HELD_S and float(np.ptp(pressure[i : k + 1], axis=0).max()) < _STILL_SHARE * scale
            for k, i in enumerate(first)
        ]
    )
    ends = np.flatnonzero(still & ~np.append(still[1:], False))
    means = [slice(first[k], k + 1) for k in ends]
    return (
        np.array([pressure[part].mean(axis=0) for part in means]).reshape(-1, poses.actuators),
        np.array([tip[part].mean(axis=0) for part in means]).reshape(-1, 3),
    )


def _groups(pressure: Array, scale: float) -> list[list[int]]:
    """Numbers of the states with equal pressures; of states in a row that are equal, only the last counts."""
    groups: list[list[int]] = []
    for k, own in enumerate(pressure):
        same = next((g for g in groups if np.abs(pressure[g[0]] - own).max() < _SAME_SHARE * scale), None)
        if same is None:
            groups.append([k])
            continue
        between = pressure[same[-1] : k]
        if np.abs(between - pressure[same[0]]).max() > _AWAY_SHARE * scale:
            same.append(k)
        else:
            same[-1] = k
    return groups
