"""Convert the cameras and the board of a rig's YAML to the types of the calibration package."""

from __future__ import annotations

import cv2
import numpy as np

from calibration.vision.board import Board
from calibration.vision.lens import Lens
from calibration.vision.planar_motion import PlaneOfMotion
from calibration.vision.transforms import RigidTransform
from rig.config.board_sections import BoardConfig
from rig.config.schema import RigConfig
from rig.config.sections import CameraConfig, Placement


def rigid(placement: Placement) -> RigidTransform:
    """Convert a placement to the rigid transform into its parent frame."""
    return RigidTransform.from_vectors(
        np.deg2rad(placement.rotation_deg),
        np.asarray(placement.translation_mm) * 1e-3,
        placement.translation_std_mm * 1e-3,
        float(np.deg2rad(placement.rotation_std_deg)),
    )


def placement_of(found: RigidTransform) -> Placement:
    """Convert a rigid transform to a placement of the rig's file."""
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
    """Return the camera's intrinsics."""
    lens = camera.lens
    return Lens.of(lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px, lens.distortion)


def camera_in_base(camera: CameraConfig) -> RigidTransform:
    """Return the camera's pose in the rod-base frame."""
    return rigid(camera.placement)


def plane_of(config: RigConfig, camera: CameraConfig) -> PlaneOfMotion | None:
    """Return the plane of the tip's motion; None where the camera makes no such assumption."""
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


def board_section(config: RigConfig) -> BoardConfig:
    """Return the section of the board; every rig with a camera has one."""
    assert config.board is not None
    return config.board


def board_of(config: RigConfig) -> Board:
    """Return the board on the end cap."""
    return board_section(config).board()


def board_in_tip(config: RigConfig) -> RigidTransform:
    """Return the board's pose in the tip frame."""
    return rigid(board_section(config).placement)
