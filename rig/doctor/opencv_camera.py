"""Check of a rig's camera that OpenCV reads: a video device, or a recording."""

from __future__ import annotations

from pathlib import Path

from rig.config.drivers import Finding
from rig.config.schema import RigConfig
from rig.config.sections import CameraConfig
from rig.doctor.cameras import PLUG_IN, examine_video, video_devices


def examine(config: RigConfig, name: str, root: Path = Path("/")) -> list[Finding]:
    """Check that the device or recording is there and may be opened; opens no video, a run may be using it."""
    return [_check(f"rig's camera {name}", config.cameras[name], root)]


def _check(topic: str, camera: CameraConfig, root: Path) -> Finding:
    from rig.hardware.cameras.recorded import is_recording  # brings OpenCV with it

    if is_recording(camera.device):
        there = Path(str(camera.device)).exists()
        found = f"recording {camera.device}" + ("" if there else " does not exist")
        return Finding(
            topic, "ok" if there else "missing", found, "" if there else "correct `device` in the rig's file"
        )
    path = f"/dev/video{camera.device}" if isinstance(camera.device, int) else camera.device
    device = root / Path(path).absolute().relative_to("/")
    if device.exists():
        return examine_video(device, root, topic, wanted=True)
    present = ", ".join(f"/dev/{other.name}" for other in video_devices(root)) or "none"
    remedy = f"{PLUG_IN}, or correct `device` in the rig's file; /dev/v4l/by-id has names that stay"
    return Finding(topic, "missing", f"{path} does not exist (video devices present: {present})", remedy)
