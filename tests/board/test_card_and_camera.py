"""Card and camera of one experiment through kernel devices, calibrated first: Comedi's board, V4L2's camera.

The bench outside of the guest holds valves, chambers and arm, and renders what its camera sees on the guest's clock.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

import runs
from rig.config.loader import load
from rig.hardware.cameras.base import open_camera
from runs.records import DetectionStatus, Status
from runs.run import Run
from scripts.vm.pci1716.shared_picture import SharedPicture, Subject
from tests.board.bench_camera_player import shared_picture
from tests.board.board_run import LONG_S, rig_text
from tests.board.monitor import Monitor
from tests.hardware.forked_run import forked, wait_until

DEVICE = "/dev/video9"
RATE_HZ = 5
BOARD = ["--corners", "9x6", "--square-mm", "16"]
BASE = "0,0,190,-90,12,0"
"""Where that board stands on the base, as BOARD_ON_THE_BASE of bench_camera.py: mm, rotation vector in deg."""
VIEWS = 8
DURATION_S = 10
STEPS = """
  - ramp: {actuators: [1], to_bar: 0.4, duration_s: 4, shape: smooth}
  - hold: {duration_s: 2}
  - ramp: {actuators: [1], to_bar: 0, duration_s: 4, shape: smooth}
"""
PROTOCOL = f"title: One actuator up and down, in view of the camera\nsteps:{STEPS}"
LEVELS_BAR = (0.105, 0.245, 0.385, 0.525, 0.665)
WITH_THE_SAME_PAST = (
    "title: The same after the pressures of a calibration, because the simulated arm creeps and softens\nsteps:"
    + "".join(
        f"\n  - ramp: {{actuators: [1, 2, 3], to_bar: {level}, duration_s: 1}}\n  - hold: {{duration_s: 4}}"
        for level in LEVELS_BAR
    )
    + "\n  - ramp: {actuators: [1, 2, 3], to_bar: 0, duration_s: 1}\n  - hold: {duration_s: 10}"
    + STEPS
)
LARGEST_OFF_MM = 0.1
LARGEST_DIFFERENCE_MM = 0.1
NOT_YET_CALIBRATED = {
    "lens: {fx_px: 620, fy_px: 620, cx_px: 320, cy_px: 240, distortion: [-0.12, 0.08, 0.0004, -0.0003, 0.0]}": (
        "lens: {fx_px: 600, fy_px: 600, cx_px: 310, cy_px: 250}"
    ),
    "translation_mm: [0, 400, 200]": "translation_mm: [3, 390, 204]",
    "device: /dev/video0": f"device: {DEVICE}\n    rate_hz: {RATE_HZ}",
}
"""What a new user knows of the camera: a data sheet and a ruler."""


@dataclass(frozen=True)
class BenchCamera:
    """The camera of the bench, and the log of what it showed."""

    shared: SharedPicture
    log: Path

    def show(self, subject: Subject) -> None:
        """Put something before the camera; returns when it is seen."""
        self.shared.header["subject"] = subject
        before = self.shared.sequence
        wait_until(lambda: self.shared.sequence >= before + 6, LONG_S, f"the camera shows {subject.name}")


@pytest.fixture
def camera(bench: Monitor, tmp_path: Path) -> Iterator[BenchCamera]:
    shared, log = shared_picture(), tmp_path / "pictures.txt"
    program = [sys.executable, "-m", "tests.board.bench_camera_player", DEVICE, log]
    player = subprocess.Popen(program, stdout=subprocess.PIPE)
    assert player.stdout is not None
    assert player.stdout.readline() == b"playing\n"
    shared.header["period_us"] = round(1e6 / RATE_HZ)
    yield BenchCamera(shared, log)
    shared.header["period_us"] = 0
    player.kill()
    player.wait()
    player.stdout.close()


def said_by(process: subprocess.Popen[bytes]) -> str:
    """What a command printed that has to succeed."""
    said = process.communicate(timeout=LONG_S)[0].decode(errors="replace")
    print(said)
    assert process.returncode == 0, said
    return said


def picture_of_the_base(camera: BenchCamera, rig_file: str, target: Path) -> None:
    """A view of the board that stands on the base."""
    camera.show(Subject.BOARD_ON_THE_BASE)
    opened = open_camera(load(rig_file), "front")
    try:
        for _ in range(3):
            image = opened.read(LONG_S).image
    finally:
        opened.close()
    assert cv2.imwrite(str(target), image)


def calibrate_pressures(camera: BenchCamera, rig_file: str, target: Path) -> None:
    """The sensors' scales, with an operator who reads the gauge at each chamber to 1 mbar.

    Without the sweep of the valves: the regulator of the rig needs none, and it takes two minutes of the guest.
    """
    gauge = ["--gauge", "of the bench", "--gauge-std-bar", "0.0003"]
    arguments = ["rig", "calibrate", "pressure", "--rig", rig_file, "--yes", "--to", str(target), *gauge, "--no-valves"]
    with forked(arguments, stdin=subprocess.PIPE) as command:
        assert command.stdin is not None
        assert command.stdout is not None
        actuator = 0
        for line in command.stdout:
            print(line.decode(), end="")
            if b"the gauge on actuator" in line:
                actuator = int(line.split(b"actuator")[1].strip(b" ?\n"))
            elif b"type the reading" in line:
                gauge_bar = camera.shared.header["chamber_pa"][0][actuator - 1] * 1e-5
                command.stdin.write(f"{gauge_bar:.3f}\n".encode())
                command.stdin.flush()
    assert command.returncode == 0


def the_run(folder: Path, rig_file: str, protocol: Path, *options: str) -> Run:
    """The archive of a run to its end."""
    said = said_by(
        forked(["rig", "run", str(protocol), "--rig", rig_file, "--out", str(folder), "--yes", "--no-report", *options])
    )
    assert "finished" in said
    (path,) = folder.glob("*.h5")
    return runs.open(path)


def measured_frames(run: Run) -> np.ndarray:
    """The frames of the last `DURATION_S` of a run in which the tip was measured."""
    recent = run.tip.protocol_s > run.tip.protocol_s[-1] - DURATION_S
    return np.asarray((run.tip.seen == DetectionStatus.MEASURED) & recent)


def rms(values: np.ndarray) -> float:
    return round(float(np.sqrt(np.mean(values**2))), 4)


def measurement_error_mm(run: Run, log: Path) -> np.ndarray:
    """Distance of each measured tip from the tip in the picture, the one that was played nearest to the frame."""
    played = np.loadtxt(log)
    half_exposure_ns = 4_000_000
    tip = run.tip
    seen = tip.seen == DetectionStatus.MEASURED
    ended_ns = run.header.started_t_ns + tip.time_s[seen] * 1e9 + half_exposure_ns
    nearest = np.abs(played[:, 0][None, :] - ended_ns[:, None]).argmin(axis=1)
    return np.linalg.norm(tip.measured_mm[seen] - played[nearest, 2:5] * 1e3, axis=1)


def the_simulated_run(folder: Path) -> Run:
    """The run of a mock rig with the same camera rate, calibrated pressures, and an arm with the same past."""
    stated = rig_text("mock").replace("height_px: 480", f"height_px: 480\n    rate_hz: {RATE_HZ}")
    rig, scales, protocol = (folder / name for name in ("mock.yaml", "mock-pressure.yaml", "past.yaml"))
    rig.write_text(stated)
    calibrate = ["rig", "calibrate", "pressure", "--rig", str(rig), "--fast", "--yes", "--seed", "1", "--no-valves"]
    said_by(forked([*calibrate, "--gauge-std-bar", "0.0003", "--to", str(scales)]))
    rig.write_text(f"{stated}\ncalibrations: [{scales.name}]\n")
    protocol.write_text(WITH_THE_SAME_PAST)
    return the_run(folder / "mock", str(rig), protocol, "--fast", "--seed", "1")


@pytest.mark.usefixtures("kernels")
def test_a_calibrated_card_and_camera_give_the_live_error_of_the_simulated_rig(
    bench: Monitor, camera: BenchCamera, tmp_path: Path
) -> None:
    began = time.monotonic()
    text = rig_text("pci1716")
    for stated, known in NOT_YET_CALIBRATED.items():
        assert stated in text
        text = text.replace(stated, known)
    rig = tmp_path / "bench.yaml"
    rig.write_text(text)
    files = {kind: tmp_path / f"{kind}.yaml" for kind in ("camera", "dlt", "pressure")}

    camera.show(Subject.BOARD_IN_HAND)
    capture = ["--capture", "--camera", "front", "--count", str(VIEWS), "--rig", str(rig), "--to", str(files["camera"])]
    said_by(forked(["rig", "calibrate", "camera", *BOARD, *capture]))
    views = tmp_path / "camera-views"
    picture_of_the_base(camera, str(rig), views / "base.png")
    place = ["--calibration", str(files["camera"]), "--world-view", "base", "--base", BASE, "--to", str(files["dlt"])]
    said_by(forked(["rig", "calibrate", "dlt", f"front={views}", *BOARD, *place, "--rig", str(rig)]))
    camera.show(Subject.TIP)
    calibrate_pressures(camera, str(rig), files["pressure"])

    calibrated = tmp_path / "calibrated.yaml"
    calibrated.write_text(f"{text}\ncalibrations: [{', '.join(file.name for file in files.values())}]\n")
    protocol = tmp_path / "one-actuator.yaml"
    protocol.write_text(PROTOCOL)
    run = the_run(tmp_path / "runs", str(calibrated), protocol)
    reference = the_simulated_run(tmp_path)

    seen, expected = measured_frames(run), measured_frames(reference)
    off_mm = np.linalg.norm(reference.tip.measured_mm[expected] - reference.simulated.tip_mm[expected], axis=1)
    figures = {
        "guest [s]": round(time.monotonic() - began, 1),
        "frames": len(seen),
        "frames measured": int(seen.sum()),
        "live error, rms [mm]": rms(run.tip.error_mm[seen]),
        "live error of the mock rig, rms [mm]": rms(reference.tip.error_mm[expected]),
        "measured against true tip, rms [mm]": rms(measurement_error_mm(run, camera.log)),
        "the same on the mock rig, rms [mm]": rms(off_mm),
        "cycles": len(run.timing.lateness_us),
        "cycles more than 1 ms late": int((run.timing.lateness_us > 1000).sum()),
    }
    Path("/out/card_and_camera.json").write_text(json.dumps(figures, indent=1) + "\n")
    for kind, file in files.items():
        Path(f"/out/{kind}.yaml").write_bytes(file.read_bytes())
    print(json.dumps(figures, indent=1))
    assert run.status is Status.FINISHED
    assert run.header.simulated
    assert seen.sum() > 0.9 * DURATION_S * RATE_HZ
    assert figures["measured against true tip, rms [mm]"] < LARGEST_OFF_MM
    expected_mm = figures["live error of the mock rig, rms [mm]"]
    assert figures["live error, rms [mm]"] == pytest.approx(expected_mm, abs=LARGEST_DIFFERENCE_MM)
