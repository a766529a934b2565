"""Pressures of a motion as they were sampled, between its frames."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calibration.identify.observations.pressure_smoothing import curve
from model.arrays import Array


@dataclass(frozen=True)
class PressureSamples:
    """Pressures (n, N) [Pa] at times (n,) [s] since the first frame of a motion."""

    time_s: Array
    pressure_pa: Array

    def at(self, time_s: Array) -> tuple[Array, Array]:
        """Pressures (M, N) [Pa] and their rates (M, N) [Pa/s] at times (M,)."""
        return curve(self.time_s, self.pressure_pa, time_s)

    def since(self, first_s: float) -> PressureSamples:
        """The samples with times since a later frame."""
        return replace(self, time_s=self.time_s - first_s)


def on_even_frames(sample_s: Array, pressure_pa: Array, frame_s: Array, period_s: float) -> PressureSamples:
    """Samples (n, N) at times (n,) on the time scale of frames (K,) that are counted as `period_s` apart.

    Cameras do not deliver evenly. Each frame keeps the pressures of its own time.
    """
    even_s = np.arange(len(frame_s)) * period_s
    known_s = np.concatenate([[frame_s[0] - 1.0], frame_s, [frame_s[-1] + 1.0]])
    time_s = np.interp(sample_s, known_s, np.concatenate([[-1.0], even_s, [even_s[-1] + 1.0]]))
    near = np.abs(sample_s - np.clip(sample_s, frame_s[0], frame_s[-1])) < 1.0
    return PressureSamples(time_s[near], pressure_pa[near])
