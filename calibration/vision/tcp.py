"""From the board's pose to the tool centre point: the tip in the rod-base frame with its covariance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibration.vision.pose import Pose
from calibration.vision.transforms import RigidTransform

Floats = NDArray[np.float64]


def tip_in_base(pose: Pose, board_in_tip: RigidTransform, camera_in_base: RigidTransform) -> tuple[Floats, Floats]:
    """Tip (3,) [m] in the rod-base frame with covariance (3, 3) [m^2].

    The errors of the transforms board in tip, board in camera and camera in base are independent, so their covariances
    add.
    """
    tip_in_board, board_covariance = board_in_tip.parent_origin()
    in_camera, pose_covariance = pose.point(tip_in_board)
    rotation = pose.rigid.rotation
    return camera_in_base.transport(in_camera, pose_covariance + rotation @ board_covariance @ rotation.T)
