"""The camera interface, and how a camera of a rig is opened."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rig.config.schema import RigConfig
from rig.config.sections import CameraConfig
from rig.hardware.driver_calls import TipSourceError
from rig.hardware.trackers.base import TrackerReading


class CameraError(TipSourceError):
    """The camera could not be opened or has failed; the message contains the remedy."""


@dataclass(frozen=True)
class TriggerMatch:
    """The pulse of the camera trigger that began an exposure.

    `t_ns` is the middle of the exposure by the pulse, `stamp_delay_ns` by how much the driver's own time is later.
    `untriggered` counts the pictures that no pulse began, since the camera was opened.
    """

    pulse: int
    t_ns: int
    stamp_delay_ns: int
    untriggered: int


@dataclass(frozen=True)
class Frame:
    """One picture, stamped at the middle of its exposure.

    `image` is (height, width) uint8 grey or (height, width, 3) uint8 BGR; `index` counts the camera's own frames, so
    that a gap is a dropped frame; `truth_m` is the simulator's tool centre point in the rod-base frame, None on a
    real camera. A triggered frame has the number of its pulse as `index`, and the time that the pulse gives.
    """

    index: int
    t_ns: int
    image: NDArray[np.uint8]
    truth_m: NDArray[np.float64] | None = None
    trigger: TriggerMatch | None = None


@dataclass(frozen=True)
class FrameSet:
    """One frame of each camera at one time, in the order of the rig file; None for a camera without a frame.

    The first frame present gives the time; `index` counts frame sets, so that a gap is a dropped one. The set of a
    rig without cameras is empty and has the time `due_ns`: of its tracker's `reading`, or of the model's prediction.
    """

    index: int
    frames: tuple[Frame | None, ...]
    due_ns: int = 0
    reading: TrackerReading | None = None

    @classmethod
    def of(cls, frame: Frame) -> FrameSet:
        """The frame set of a rig with one camera."""
        return cls(frame.index, (frame,))

    @property
    def leader(self) -> int:
        """Number of the camera whose frame gives the time."""
        return next(k for k, frame in enumerate(self.frames) if frame is not None)

    @property
    def lead(self) -> Frame:
        """The frame that gives the time."""
        return next(frame for frame in self.frames if frame is not None)

    @property
    def t_ns(self) -> int:
        """Middle of the leading frame's exposure."""
        return self.lead.t_ns if self.frames else self.due_ns

    @property
    def triggers(self) -> tuple[TriggerMatch | None, ...]:
        """The pulse of each camera's frame; None without a frame, or without a trigger."""
        return tuple(None if frame is None else frame.trigger for frame in self.frames)

    @property
    def truth_m(self) -> NDArray[np.float64] | None:
        """The simulator's tool centre point at this time; None without one."""
        if self.frames:
            return self.lead.truth_m
        return None if self.reading is None else self.reading.truth_m


class Camera(Protocol):
    """An open camera."""

    def read(self, timeout_s: float) -> Frame:
        """Return the newest frame, waiting for one that was not returned before; `CameraError` after the time-out."""

    def close(self) -> None:
        """Release the device."""


def wrong_size(camera: CameraConfig, width_px: int, height_px: int) -> str:
    """The message about pictures of this size; empty where it is that of the rig file."""
    if (width_px, height_px) == (camera.width_px, camera.height_px):
        return ""
    asked = f"{camera.width_px}x{camera.height_px}: the lens was calibrated for the latter"
    return f"{width_px}x{height_px} and the rig asks for {asked}"


def open_camera(config: RigConfig, name: str, seed: int = 0) -> Camera:
    """Open the rig's camera `name`; `seed` is for simulated cameras. Raises CameraError."""
    camera: Camera = config.cameras[name].driven_by.load()(config, name, seed)
    return camera
