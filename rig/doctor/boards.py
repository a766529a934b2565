"""Check of a rig's board in the pictures of its cameras: seen whole, and large enough to be found."""

from __future__ import annotations

from rig.config.drivers import Finding
from rig.config.schema import RigConfig


def rig_boards(config: RigConfig) -> list[Finding]:
    """How large each camera sees the board of the vented, straight arm, by the rig file."""
    if config.board is None:
        return []
    return [_in_camera(config, name) for name in config.cameras]


def _in_camera(config: RigConfig, name: str) -> Finding:
    import cv2
    import numpy as np

    from calibration.vision.transforms import RigidTransform
    from model.statics import statics
    from rig.config.arm_model import model_arm
    from rig.config.optics import board_in_tip, board_section, camera_in_base, lens_of

    topic = f"board in camera {name}"
    section, camera = board_section(config), config.cameras[name]
    board, detail = section.board(), section.board().finest
    rest = statics(model_arm(config), np.zeros(config.actuators))
    tip = RigidTransform(rest.tip_rotation, rest.tip_m)
    pose = camera_in_base(camera).inverse() @ tip @ board_in_tip(config)
    if pose.rotation[:, 2] @ pose.translation_m >= 0 or pose.translation_m[2] <= 0:
        remedy = "correct `placement` of the camera or of the board in the rig's file"
        return Finding(topic, "missing", f"{section.words}: the camera sees its back, or not at all", remedy)
    corners_px = lens_of(camera).project(
        board.corners_m, np.asarray(cv2.Rodrigues(pose.rotation)[0], np.float64).ravel(), pose.translation_m
    )
    size_px = board.spacing(corners_px) * detail.size
    inside = int(np.sum(((corners_px >= 0) & (corners_px < (camera.width_px, camera.height_px))).all(axis=1)))
    found = f"{section.words}; {size_px:.1f} px for a {detail.name}, arm straight"
    if inside < len(corners_px):
        outside = f"{len(corners_px) - inside} of its corners are outside the picture"
        return Finding(
            topic, "missing" if not inside else "note", f"{found}; {outside}", "move the camera or the board"
        )
    if size_px < detail.least_px:
        remedy = f"a {detail.name} should have {detail.least_px:g} px: take a larger one, or a nearer or finer camera"
        return Finding(topic, "note", found, remedy)
    return Finding(topic, "ok", found)
