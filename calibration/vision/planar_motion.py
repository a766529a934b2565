"""Motion in a known plane as a prior on the pose of the board."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.vision.transforms import RigidTransform

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PlaneOfMotion:
    """The tip moves in a plane of the rod-base frame and turns about its normal only.

    `normal` (3,) of length 1 and a point of the plane `through_m` (3,), in the rod-base frame. `offset_std_m` and
    `tilt_std_rad` are the standard uncertainties of the distance from the plane and of the rotation out of it.
    """

    normal: Floats
    through_m: Floats
    offset_std_m: float
    tilt_std_rad: float
    board_in_tip: RigidTransform
    camera_in_base: RigidTransform

    def departure(self, rotation_vector: Floats, translation_m: Floats) -> tuple[Floats, Floats]:
        """Offset and two tilts (3,) of the tip out of the plane in standard uncertainties, and derivatives (3, 6).

        By rotation vector and translation of the board in the camera frame. The uncertainties of camera and board poses
        are included.
        """
        camera, board = self.camera_in_base, self.board_in_tip
        rotation, derivative = cv2.Rodrigues(rotation_vector)
        slopes = derivative.reshape(3, 3, 3)
        tip = -board.rotation.T @ board.translation_m
        tip_in_camera = rotation @ tip + translation_m
        offset = self.normal @ (camera.apply(tip_in_camera) - self.through_m)
        by_offset = np.concatenate([(slopes @ tip) @ camera.rotation.T @ self.normal, self.normal @ camera.rotation])
        # The normal fixed to the tip: equal to that of the plane while the tip rotates about it only.
        tip_normal = board.rotation.T @ self.normal
        across = self._across
        tilt = across @ (camera.rotation @ (rotation @ tip_normal))
        by_tilt = np.hstack([across @ camera.rotation @ (slopes @ tip_normal).T, np.zeros((2, 3))])
        offset_std = np.sqrt(
            self.offset_std_m**2
            + camera.translation_std_m**2
            + board.translation_std_m**2
            + (camera.rotation_std_rad * np.linalg.norm(tip_in_camera)) ** 2
            + (board.rotation_std_rad * np.linalg.norm(tip)) ** 2
        )
        tilt_std = np.sqrt(self.tilt_std_rad**2 + camera.rotation_std_rad**2 + board.rotation_std_rad**2)
        departure = np.concatenate([[offset / offset_std], tilt / tilt_std])
        return departure, np.vstack([by_offset / offset_std, by_tilt / tilt_std])

    @property
    def _across(self) -> Floats:
        """Two directions (2, 3) in the plane."""
        first = np.cross(self.normal, np.eye(3)[np.argmin(np.abs(self.normal))])
        first /= np.linalg.norm(first)
        return np.stack([first, np.cross(self.normal, first)])
