"""The lens: pinhole intrinsics with Brown-Conrady distortion, in pixels."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from calibration.vision import projection
from model.arrays import Array

# The fixed-point iteration of the inverse distortion gains about one digit a step for usual lenses.
_UNDISTORT = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-10)


@dataclass(frozen=True)
class Lens:
    """`matrix` (3, 3) camera matrix [px], `distortion` (5,) as OpenCV's k1, k2, p1, p2, k3."""

    matrix: Array
    distortion: Array

    @classmethod
    def of(
        cls, fx_px: float, fy_px: float, cx_px: float, cy_px: float, distortion: tuple[float, ...] = (0.0,) * 5
    ) -> Lens:
        """Build from focal lengths and principal point [px]."""
        matrix = np.array([[fx_px, 0.0, cx_px], [0.0, fy_px, cy_px], [0.0, 0.0, 1.0]])
        return cls(matrix, np.asarray(distortion, dtype=np.float64))

    def project(self, points_m: Array, rotation_vector: Array, translation_m: Array) -> Array:
        """Pixels (n, 2) of points (n, 3) whose frame stands at the given pose before the camera."""
        points, pixels = np.ascontiguousarray(points_m, dtype=np.float64), np.empty((len(points_m), 2))
        projection.project(points, *self._arguments(rotation_vector, translation_m), pixels)
        return pixels

    def project_with_jacobian(
        self, points_m: Array, rotation_vector: Array, translation_m: Array
    ) -> tuple[Array, Array]:
        """Like `project`, with the derivatives (2 n, 6) by rotation vector and translation; rows u0, v0, u1, ..."""
        points = np.ascontiguousarray(points_m, dtype=np.float64)
        pixels, slopes = np.empty((len(points), 2)), np.empty((len(points), 2, 6))
        projection.project_with_slopes(points, *self._arguments(rotation_vector, translation_m), pixels, slopes)
        return pixels, slopes.reshape(-1, 6)

    def _arguments(self, rotation_vector: Array, translation_m: Array) -> tuple[Array, Array, Array, Array]:
        """What the kernels take beside the points."""
        vector, translation = (np.array(one, np.float64).ravel() for one in (rotation_vector, translation_m))
        return vector, translation, np.ascontiguousarray(self.matrix), np.ascontiguousarray(self.distortion)

    def rays(self, pixels: Array) -> Array:
        """Normalised, undistorted image coordinates (n, 2) of pixels (n, 2)."""
        flat = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
        rays = cv2.undistortPointsIter(flat, self.matrix, self.distortion, None, None, _UNDISTORT)  # type: ignore[call-overload]
        return np.asarray(rays[:, 0, :], dtype=np.float64)
