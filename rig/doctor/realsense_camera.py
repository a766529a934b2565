"""Check of a rig's RealSense camera."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from rig.config.drivers import Finding
from rig.config.schema import RigConfig
from rig.config.sections import CameraConfig
from rig.doctor.cameras import PLUG_IN
from rig.hardware.cameras.realsense import ANY, RECORDINGS, why_unusable


def examine(config: RigConfig, name: str) -> list[Finding]:
    """Check that librealsense lists the camera, or that its recording is there; opens none, a run may be using it."""
    return [_check(f"rig's camera {name}", config.cameras[name])]


def _check(topic: str, camera: CameraConfig) -> Finding:
    wanted = str(camera.device)
    if Path(wanted).suffix in RECORDINGS:
        there = Path(wanted).is_file()
        return Finding(topic, "ok" if there else "missing", f"recording {wanted}", "correct `device` in the rig's file")
    try:
        rs: Any = importlib.import_module("pyrealsense2")
    except ImportError as why:
        found, remedy = why_unusable(why)
        return Finding(topic, "missing", found, remedy)
    serials = [device.get_info(rs.camera_info.serial_number) for device in rs.context().query_devices()]
    if wanted in serials or (wanted == ANY and serials):
        return Finding(topic, "ok", f"RealSense {wanted}")
    present = ", ".join(serials) or "none"
    return Finding(topic, "missing", f"no RealSense {wanted} (present: {present})", f"{PLUG_IN}, or correct `device`")
