"""Times of the model's predictions in a rig without cameras."""

from __future__ import annotations

import time

from rig.config.schema import RigConfig
from rig.hardware.cameras.base import FrameSet


class PredictionClock:
    """Gives an empty frame set per period of the model, in place of the cameras."""

    def __init__(self, config: RigConfig) -> None:
        self._period_ns = round(1e9 / config.observation_hz)
        self._start_ns = time.monotonic_ns()
        self._period = self._count = 0

    def await_all(self, timeout_s: float) -> None:
        """Return at once: there is no camera to wait for."""

    def read(self, timeout_s: float) -> FrameSet:
        """Wait for the next period; periods that have passed meanwhile are left out, because no frame was lost."""
        passed = (time.monotonic_ns() - self._start_ns) // self._period_ns
        self._period = max(self._period, passed) + 1
        due_ns = self._start_ns + self._period * self._period_ns
        time.sleep(max(0, due_ns - time.monotonic_ns()) * 1e-9)
        self._count += 1
        return FrameSet(self._count, (), due_ns)

    def close(self) -> None:
        """Release nothing."""
