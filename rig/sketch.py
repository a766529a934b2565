"""What there is to draw of one frame: the board and both tips in the picture, the arm's lines in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import model
from rig.config import RigConfig
from rig.eye import Measurement
from rig.optics import camera_in_base, lens_of

Floats = NDArray[np.float64]
_NOWHERE = np.zeros(3)


@dataclass(frozen=True)
class Sketch:
    """Pixels of the corners (n, 2) and of the measured and the model's tip (2,); NaN where there is none.

    `lines_m` (1 + N, points, 3): the arm's axis and its N actuators' in the rod-base frame.
    """

    corners_px: Floats
    tip_px: Floats
    model_px: Floats
    lines_m: Floats


class Sketcher:
    """Draws for one camera of a rig."""

    def __init__(self, config: RigConfig, camera: str, points: int) -> None:
        """`points` along each line."""
        self._lens = lens_of(config.cameras[camera])
        self._base_in_camera = camera_in_base(config.cameras[camera]).inverse()
        self._points = points
        self._lines = 1 + config.actuators

    def sketch(self, measurement: Measurement, shape: model.Shape | None) -> Sketch:
        """Sketch a frame from what was measured in it and the arm's modelled shape, None where it was not solved."""
        corners = measurement.corners_px
        return Sketch(
            corners_px=np.empty((0, 2)) if corners is None else corners,
            tip_px=self.pixel(measurement.tip_m),
            model_px=self.pixel(np.full(3, np.nan) if shape is None else shape.tip_m),
            lines_m=self.lines(shape),
        )

    def pixel(self, point_m: Floats) -> Floats:
        """Where a point (3,) of the rod-base frame is in the picture (2,); NaN for one behind the camera."""
        seen = self._base_in_camera.apply(point_m)
        if not seen[2] > 0:
            return np.full(2, np.nan)
        pixel: Floats = self._lens.project(seen[None], _NOWHERE, _NOWHERE)[0]
        return pixel

    def lines(self, shape: model.Shape | None) -> Floats:
        """The arm's axis and actuators (1 + N, points, 3) [m]; NaN for no shape."""
        if shape is None:
            return np.full((self._lines, self._points, 3), np.nan)
        at = np.linspace(0, len(shape.s_m) - 1, self._points).round().astype(int)
        axis, rotation = shape.p_m[at], shape.rotation[at]
        offsets = np.column_stack([shape.actuator_xy_m, np.zeros(len(shape.actuator_xy_m))])
        actuators = axis + np.einsum("sij,aj->asi", rotation, offsets)
        return np.concatenate([axis[None], actuators])
