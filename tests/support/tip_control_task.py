"""An arm, settings of its tip control, and a circle to follow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

import model
from benchmarks.support.tip_closed_loop import Task
from model.inverse.static_map import StaticMap
from rig.tip_control.interface import TipControlSettings
from rig.tip_control.tip_dynamics import TipDynamics
from runs.interpolation import interpolated

LIMIT_PA, RATE_PA_S = 0.7e5, 1e5
_PAPER = model.Arm.paper()
ARM = _PAPER.with_segment(material=replace(_PAPER.material, damping_s=0.01))
SETTINGS = TipControlSettings(ARM, (0, 1, 2), LIMIT_PA, RATE_PA_S, 1 / 30, 0.04, 0.015)
OTHER = ARM.with_segment(material=replace(ARM.material, a1_per_n=0.0077, rpe_per_bar=0.0515, density_kg_m3=1130.0))
"""An arm unlike the model."""


def circle(frequency_hz: float, duration_s: float, radius_m: float = 0.015) -> Task:
    """A circle from rest on; its feed-forward is that of the first-mode model."""
    chart, dynamics = StaticMap.of(ARM, (0, 1, 2), LIMIT_PA), TipDynamics.of(ARM, LIMIT_PA)
    times = np.arange(0.0, duration_s + 2.0, 0.005)
    turns = 2 * np.pi * frequency_hz * np.where(times < 1, 0.5 * times**2, times - 0.5)
    position = np.stack([radius_m * np.cos(turns), radius_m * np.sin(turns), np.full_like(turns, 0.19)], axis=1)
    velocity = np.gradient(position, 0.005, axis=0)
    drive = position + dynamics.tau_s * velocity + np.gradient(velocity, 0.005, axis=0) / dynamics.omega_rad_s**2
    feed = chart.inverse(drive, np.full(3, 3e4))

    def at(values: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        return lambda times_s: interpolated(times_s, times, values)

    return Task(duration_s, at(position), at(velocity), at(feed), 1 / frequency_hz)
