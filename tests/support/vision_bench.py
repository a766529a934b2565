"""Helpers of the vision tests: the mock rig, a tip that sweeps its workspace, and a scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.vision.board import Board
from calibration.vision.checkerboard import Checkerboard
from calibration.vision.lens import Lens
from calibration.vision.transforms import RigidTransform
from rig.simulator.scene import ImageDegradation, Scene
from rig.simulator.tip_pose import TipPose

BOARD = Checkerboard(7, 6, 0.008)
LENS = Lens.of(900, 900, 320, 240, (-0.12, 0.08, 0.0004, -0.0003, 0.0))
SIZE = (640, 480)
FRAME_NS = 33_333_333
DEGRADATION = ImageDegradation(0.6, 2.0)
FACING = np.diag([1.0, -1.0, -1.0])
"""A board that looks straight into the camera, upright."""


@dataclass(frozen=True)
class Sweep:
    """A tip that swings through the whole workspace: x +-65 mm, z 165..185 mm, +-45 deg about y."""

    rate: float = 0.7
    out_of_plane_rad: float = 0.01

    def pose_at(self, t_ns: int) -> TipPose:
        """The pose at any time."""
        a = t_ns * 1e-9 * self.rate
        position = np.array([0.065 * np.sin(a), 0.001 * np.sin(1.7 * a), 0.175 + 0.010 * np.cos(2.3 * a)])
        wobble = self.out_of_plane_rad * np.array([np.sin(3 * a), 0.0, np.cos(2 * a)])
        turn = np.array([0.0, np.pi / 4 * np.sin(a), 0.0]) + wobble
        return TipPose(t_ns, position, RigidTransform.from_vectors(turn, (0.0, 0.0, 0.0)).rotation)


def facing(
    x_m: float = 0.0, y_m: float = 0.0, distance_m: float = 0.4, tilt_deg: float = 30.0, roll_deg: float = 0.0
) -> RigidTransform:
    """The board before the camera, tilted back about its own x axis."""
    roll = RigidTransform.from_vectors((0.0, 0.0, np.deg2rad(roll_deg)), (0.0, 0.0, 0.0)).rotation
    tilt = RigidTransform.from_vectors((np.deg2rad(tilt_deg), 0.0, 0.0), (0.0, 0.0, 0.0)).rotation
    return RigidTransform(roll @ FACING @ tilt, np.array([x_m, y_m, distance_m]))


def scene(degradation: ImageDegradation = DEGRADATION, seed: int = 1, board: Board = BOARD) -> Scene:
    """The mock camera's scene."""
    return Scene(board, LENS, SIZE, degradation, seed)


def still(pose: RigidTransform, index: int = 0, view: Scene | None = None) -> NDArray[np.uint8]:
    """A picture of a board that does not move."""
    return (view or scene()).render(pose, pose, pose, index)
