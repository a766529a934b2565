"""From the board's pose to the tip in the rod-base frame: tool centre point, orientation, and their covariance."""

from __future__ import annotations

import numpy as np

from calibration.rotation_vectors import cross_matrix, left_jacobian
from calibration.vision.pose import Pose
from calibration.vision.transforms import RigidTransform
from model.arrays import Array

_UNIT = np.eye(3)


def tip_in_base(
    pose: Pose, board_in_tip: RigidTransform, camera_in_base: RigidTransform
) -> tuple[RigidTransform, Array]:
    """Tip in the rod-base frame with the covariance (6, 6) of its position [m] and of a small rotation [rad].

    The errors of the transforms board in tip, board in camera and camera in base are independent, so their covariances
    add. Rotations are about the axes of the rod base.
    """
    tip_in_camera = pose.rigid @ board_in_tip.inverse()
    lever_m = tip_in_camera.translation_m - pose.translation_m
    turn = left_jacobian(pose.rotation_vector)
    by_pose = np.zeros((6, 6))
    by_pose[:3, :3], by_pose[:3, 3:], by_pose[3:, :3] = -cross_matrix(lever_m) @ turn, _UNIT, turn
    covariance = by_pose @ pose.covariance @ by_pose.T + board_in_tip.error_covariance(lever_m)
    return camera_in_base.transport_pose(tip_in_camera, covariance)
