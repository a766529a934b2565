"""Matches the frames of a triggered camera to the pulses that began their exposures."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rig.config.sections import CameraConfig
from rig.hardware.cameras.base import Camera, CameraError, Frame, TriggerMatch

EARLIEST, LATEST = -0.25, 0.75
"""How far the time of a driver may be from that of the pulse, in frame periods. It is late rather than early: a driver
without stamps of its own gives the time at which the picture arrived."""
RECENT_PULSES = 64
"""Pulses among which that of a frame is looked for."""

PulseRows = NDArray[np.void]


class PulseMatcher:
    """Matches the times that the driver of one camera gives to pulses, in order; each pulse begins one frame."""

    def __init__(self, camera: CameraConfig) -> None:
        self._half_exposure_ns = round(camera.exposure_ms * 5e5)
        period_ns = 1e9 / camera.rate_hz
        self._earliest_ns, self._latest_ns = round(EARLIEST * period_ns), round(LATEST * period_ns)
        self._last = -1
        self.untriggered = 0
        """Frames that no pulse began."""

    def match(self, stamp_ns: int, pulses: PulseRows) -> TriggerMatch | None:
        """Return the pulse that began the frame with this mid-exposure by its driver; None if there is none.

        `pulses` (n,) of `pulse_dtype` are recent ones, in order of time. The newest that the frame may follow counts.
        """
        middles_ns = pulses["t_ns"] + self._half_exposure_ns
        before = int(np.searchsorted(middles_ns, stamp_ns - self._earliest_ns, side="right"))
        if before:
            pulse, t_ns = int(pulses["pulse"][before - 1]), int(middles_ns[before - 1])
            if stamp_ns - t_ns < self._latest_ns and pulse > self._last:
                self._last = pulse
                return TriggerMatch(pulse, t_ns, stamp_ns - t_ns, self.untriggered)
        self.untriggered += 1
        return None


class TriggeredCamera:
    """A camera whose exposures a card triggers; frames that no pulse began are left out and counted."""

    def __init__(self, name: str, settings: CameraConfig, camera: Camera, pulses: Callable[[], PulseRows]) -> None:
        """`pulses` returns the recent pulses (n,) of `pulse_dtype`."""
        self._name, self._camera, self._pulses = name, camera, pulses
        self._matcher = PulseMatcher(settings)

    def read(self, timeout_s: float) -> Frame:
        """Return the newest triggered frame, with the number of its pulse and the time by it; as `Camera.read`."""
        until, before = time.monotonic() + timeout_s, self._matcher.untriggered
        while True:
            try:
                frame = self._camera.read(max(0.0, until - time.monotonic()))
            except CameraError as error:
                if self._matcher.untriggered > before:
                    raise CameraError(
                        f"camera {self._name} gives pictures that no trigger pulse begins: set it to external trigger"
                    ) from error
                raise
            if match := self._matcher.match(frame.t_ns, self._pulses()):
                return replace(frame, index=match.pulse, t_ns=match.t_ns, trigger=match)

    def close(self) -> None:
        self._camera.close()
