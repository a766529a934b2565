"""Overlay of one frame: the board, both tips and the backbone in the picture, the arm's lines in space."""

from __future__ import annotations

import numpy as np

import model
from model.arrays import Array
from rig.config.optics import camera_in_base, lens_of
from rig.config.schema import RigConfig
from runs.records import BACKBONE_POINTS, ImageAnnotations

_NOWHERE = np.zeros(3)


class OverlayProjector:
    """Projects measurements and the arm into one camera of a rig."""

    def __init__(self, config: RigConfig, camera: str) -> None:
        self._lens = lens_of(config.cameras[camera])
        self._base_in_camera = camera_in_base(config.cameras[camera]).inverse()

    def annotations(self, corners_px: Array | None, tip_m: Array, shape: model.Shape | None) -> ImageAnnotations:
        """Return the annotations of a picture: the board's corners, both tips and the backbone."""
        line = backbone(shape)
        points = self.pixels(np.vstack([tip_m, np.full(3, np.nan) if shape is None else shape.tip_m, line]))
        return ImageAnnotations.of(
            np.empty((0, 2)) if corners_px is None else corners_px, points[0], points[1], points[2:]
        )

    def pixels(self, points_m: Array) -> Array:
        """Project points (n, 3) of the rod-base frame to the picture (n, 2); NaN behind the camera."""
        in_camera = self._base_in_camera.apply(points_m)
        visible = in_camera[:, 2] > 0
        pixels = np.full((len(in_camera), 2), np.nan)
        if visible.any():
            pixels[visible] = self._lens.project(in_camera[visible], _NOWHERE, _NOWHERE)
        return pixels


def arm_lines(config: RigConfig, shape: model.Shape | None, points: int) -> Array:
    """Return the arm's axis and actuators (1 + N, points, 3) [m], each along its own segment; NaN without a shape."""
    if shape is None:
        return np.full((1 + config.actuators, points, 3), np.nan)
    along = np.linspace(
        [0, *shape.actuator_points[:, 0]], [len(shape.s_m) - 1, *shape.actuator_points[:, 1] - 1], points
    )
    at = along.T.round().astype(int)
    offsets = np.zeros((1 + config.actuators, 3))
    offsets[1:, :2] = shape.actuator_xy_m
    lines: Array = shape.p_m[at] + np.einsum("asij,aj->asi", shape.rotation[at], offsets)
    return lines


def backbone(shape: model.Shape | None) -> Array:
    """Return the arm's centre line (BACKBONE_POINTS, 3) [m], evenly spaced in rest length; NaN without a shape."""
    if shape is None:
        return np.full((BACKBONE_POINTS, 3), np.nan)
    at = np.linspace(float(shape.s_m[0]), float(shape.s_m[-1]), BACKBONE_POINTS)
    line = np.empty((BACKBONE_POINTS, 3))
    for axis in range(3):
        line[:, axis] = np.interp(at, shape.s_m, shape.p_m[:, axis])
    return line
