"""What `rig doctor` says of cameras, on made-up machines with video devices."""

from __future__ import annotations

import errno
import os
import struct
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import rig.config.loader
from rig.config.drivers import Finding
from rig.config.schema import RigConfig
from rig.doctor import cameras, examine
from rig.doctor import machine as computer


class Cameras:
    """A made-up machine with video devices; what V4L2 would say of each is given."""

    def __init__(self, root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.root = root
        self._can: dict[str, int] = {}
        (root / "dev").mkdir()
        monkeypatch.setattr("fcntl.ioctl", self._ioctl)

    def add(self, name: str, called: str, can: int) -> None:
        (self.root / "dev" / name).touch()
        self._can[str(self.root / "dev" / name)] = can
        folder = self.root / "sys/class/video4linux" / name
        folder.mkdir(parents=True)
        (folder / "name").write_text(f"{called}\n")

    def _ioctl(self, fd: int, request: int, answer: bytearray) -> int:
        can = self._can[str(Path(f"/proc/self/fd/{fd}").readlink())]
        answer[:] = struct.pack("<16s32s32sIII12x", b"uvcvideo", b"x", b"usb", 0x60100, 0x84A00001, can)
        return 0


@pytest.fixture
def plugged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Cameras:
    return Cameras(tmp_path, monkeypatch)


def with_camera(driver: str, device: str | int) -> RigConfig:
    config = rig.config.loader.load("pci1716")
    camera = config.cameras["front"].model_copy(update={"driver": driver, "device": device})
    return config.model_copy(update={"cameras": {"front": camera}})


def test_a_camera_is_distinguished_from_its_second_device_without_pictures(plugged: Cameras) -> None:
    plugged.add("video10", "HD Webcam", 0x04A00000)
    plugged.add("video2", "HD Webcam", 0x04200001)
    first, second = cameras.cameras(plugged.root)
    assert (first.verdict, first.found) == ("ok", "/dev/video2: HD Webcam")
    assert second.verdict == "note"
    assert "/dev/video10: HD Webcam: gives no pictures" in second.found


def test_a_device_without_hardware_is_not_queried(plugged: Cameras) -> None:
    """v4l2loopback, asked while no program feeds it, refuses the next program that wants to feed it."""
    plugged.add("video9", "played", 0x05200000)
    shown = plugged.root / "sys/class/video4linux/video9"
    made_up = plugged.root / "sys/devices/virtual/video4linux/video9"
    made_up.parent.mkdir(parents=True)
    shown.rename(made_up)
    shown.symlink_to(made_up)
    (said,) = cameras.cameras(plugged.root)
    assert (said.verdict, said.found) == ("ok", "/dev/video9: played")


def refusing(monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    def refuse(path: Path, flags: int) -> int:
        raise OSError(number, os.strerror(number), str(path))

    monkeypatch.setattr(os, "open", refuse)


def test_for_a_camera_without_permission_the_group_to_join_is_named(
    plugged: Cameras, monkeypatch: pytest.MonkeyPatch
) -> None:
    plugged.add("video0", "HD Webcam", 0x04200001)
    refusing(monkeypatch, errno.EACCES)
    group = computer.group_name((plugged.root / "dev/video0").stat().st_gid)
    (said,) = cameras.cameras(plugged.root)
    assert (said.verdict, said.remedy) == ("missing", f"sudo adduser $USER {group}, then log in again")


@pytest.mark.parametrize("number", [errno.EBUSY, errno.ENXIO])
def test_a_camera_that_cannot_be_opened_is_reported_with_the_reason(
    plugged: Cameras, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    plugged.add("video0", "HD Webcam", 0x04200001)
    refusing(monkeypatch, number)
    (said,) = cameras.cameras(plugged.root)
    assert said.verdict == "missing"
    assert said.found == f"/dev/video0: HD Webcam: cannot be opened ({os.strerror(number)})"
    assert said.remedy


def test_a_missing_camera_is_a_fault_only_if_a_rig_needs_one(plugged: Cameras) -> None:
    (said,) = cameras.cameras(plugged.root)
    assert said.verdict == "note"
    (said,) = cameras.examine_opencv(with_camera("opencv", "/dev/video0"), "front", plugged.root)
    assert (said.topic, said.verdict) == ("rig's camera front", "missing")
    assert said.found == "/dev/video0 does not exist (video devices present: none)"


@pytest.mark.parametrize("device", ["/dev/video2", 2])
def test_a_camera_of_the_rig_that_is_present_is_named(plugged: Cameras, device: str | int) -> None:
    plugged.add("video2", "HD Webcam", 0x04200001)
    (said,) = cameras.examine_opencv(with_camera("opencv", device), "front", plugged.root)
    assert said == Finding("rig's camera front", "ok", "/dev/video2: HD Webcam")


def test_a_camera_may_be_named_by_its_persistent_path(plugged: Cameras) -> None:
    plugged.add("video2", "HD Webcam", 0x04200001)
    steady = plugged.root / "dev/v4l/by-id"
    steady.mkdir(parents=True)
    (steady / "usb-webcam-index0").symlink_to("../../video2")
    (said,) = cameras.examine_opencv(with_camera("opencv", "/dev/v4l/by-id/usb-webcam-index0"), "front", plugged.root)
    assert said == Finding("rig's camera front", "ok", "/dev/v4l/by-id/usb-webcam-index0: HD Webcam")


def test_a_rig_that_names_a_device_without_pictures_is_reported(plugged: Cameras) -> None:
    plugged.add("video3", "HD Webcam", 0x04A00000)
    (said,) = cameras.examine_opencv(with_camera("opencv", "/dev/video3"), "front", plugged.root)
    assert said.verdict == "missing"
    assert "gives no pictures" in said.found


def test_a_rigs_recording_needs_no_camera(plugged: Cameras, tmp_path: Path) -> None:
    (said,) = cameras.examine_opencv(with_camera("opencv", str(tmp_path)), "front", plugged.root)
    assert said.verdict == "ok"
    (said,) = cameras.examine_opencv(with_camera("opencv", str(tmp_path / "gone.mp4")), "front", plugged.root)
    assert (said.verdict, said.found) == ("missing", f"recording {tmp_path / 'gone.mp4'} does not exist")


class RealSense:
    """As much of pyrealsense2 as lists what is plugged in; its context and its devices are itself."""

    camera_info = SimpleNamespace(serial_number="serial")

    def __init__(self, serial: str) -> None:
        self._serial = serial

    def context(self) -> RealSense:
        return self

    def query_devices(self) -> list[RealSense]:
        return [self]

    def get_info(self, what: str) -> str:
        assert what == "serial"
        return self._serial


def test_a_realsense_is_searched_by_its_serial_number(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    (said,) = cameras.examine_realsense(with_camera("realsense", "any"), "front")
    assert (said.verdict, said.remedy) == ("missing", "pip install pyrealsense2")
    monkeypatch.setitem(sys.modules, "pyrealsense2", RealSense("1234"))
    assert [
        cameras.examine_realsense(with_camera("realsense", device), "front")[0].verdict
        for device in ("any", "1234", "999")
    ] == ["ok", "ok", "missing"]


def test_a_missing_camera_of_the_rig_is_a_fault(tmp_path: Path) -> None:
    topics = {f.topic: f.verdict for f in examine(tmp_path, with_camera("opencv", "/dev/video987"))}
    assert topics["rig's camera front"] == "missing"
