"""What the rig's YAML says of cameras and board, in the terms of the calibration room."""

from __future__ import annotations

import cv2
import numpy as np

from calibration.vision.board import Board
from calibration.vision.lens import Lens
from calibration.vision.planar_motion import PlaneOfMotion
from calibration.vision.transforms import RigidTransform
from rig.config.schema import CameraConfig, Placement, RigConfig


def rigid(placement: Placement) -> RigidTransform:
    """A placement as a transform into its parent frame."""
    return RigidTransform.from_vectors(
        np.deg2rad(placement.rotation_deg),
        np.asarray(placement.translation_mm) * 1e-3,
        placement.translation_std_mm * 1e-3,
        float(np.deg2rad(placement.rotation_std_deg)),
    )


def placement_of(found: RigidTransform) -> Placement:
    """A transform as the rig's file states it."""
    x, y, z = (float(v) for v in found.translation_m * 1e3)
    vector, _ = cv2.Rodrigues(found.rotation)
    a, b, c = (float(v) for v in np.rad2deg(np.asarray(vector, dtype=np.float64)).ravel())
    return Placement(
        translation_mm=(x, y, z),
        rotation_deg=(a, b, c),
        translation_std_mm=found.translation_std_m * 1e3,
        rotation_std_deg=float(np.rad2deg(found.rotation_std_rad)),
    )


def lens_of(camera: CameraConfig) -> Lens:
    """The camera's intrinsics."""
    lens = camera.lens
    return Lens.of(lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px, lens.distortion)


def camera_in_base(camera: CameraConfig) -> RigidTransform:
    """The camera in the rod-base frame."""
    return rigid(camera.placement)


def plane_of(config: RigConfig, camera: CameraConfig) -> PlaneOfMotion | None:
    """The plane that the tip keeps to, where the camera may take that for granted."""
    plane = camera.planar_motion
    if plane is None:
        return None
    normal = np.asarray(plane.normal) / np.linalg.norm(plane.normal)
    return PlaneOfMotion(
        normal,
        np.asarray(plane.through_mm) * 1e-3,
        plane.offset_std_mm * 1e-3,
        float(np.deg2rad(plane.tilt_std_deg)),
        board_in_tip(config),
        camera_in_base(camera),
    )


def board_of(config: RigConfig) -> Board:
    """The checkerboard."""
    board = config.board
    return Board(board.squares_x, board.squares_y, board.square_mm * 1e-3)


def board_in_tip(config: RigConfig) -> RigidTransform:
    """The board in the tip frame."""
    return rigid(config.board.placement)
