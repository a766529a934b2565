"""The camera of the bench behind the emulated board: it exposes on the guest's clock, into memory of the guest."""

from __future__ import annotations

import mmap
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.images import Image
from calibration.vision.checkerboard import Checkerboard
from calibration.vision.transforms import RigidTransform
from rig.config.optics import camera_in_base, lens_of
from rig.config.schema import RigConfig
from rig.simulator.mock_camera import MockCamera
from rig.simulator.plant import Plant
from rig.simulator.scene import ImageDegradation, Scene
from rig.simulator.simulated_operator import shown_boards
from scripts.vm.pci1716.shared_picture import SIZE_BYTES, SharedPicture, Subject

CAMERA = "front"
CORNERS = (9, 6)
SQUARE_MM = 16.0
BOARD_ON_THE_BASE = RigidTransform.from_vectors(np.deg2rad([-90.0, 12.0, 0.0]), (0.0, 0.0, 0.19))
"""Where the calibration board stands on the base; the operator has measured it."""
HELD_PICTURES = 2
"""Pictures of each position of a board in the hand, for each of those of `shown_boards`."""
_VIDEO_RANGE = (16 + np.arange(256) * (219 / 255)).round().astype(np.uint8)
_NO_COLOUR = 128


class BenchCamera:
    """Renders what stands before the camera at each exposure's end."""

    def __init__(self, path: Path, config: RigConfig, plant: Plant, seed: int) -> None:
        self._camera = config.cameras[CAMERA]
        with path.open("r+b") as file:
            file.truncate(SIZE_BYTES)
            self._shared = SharedPicture(
                mmap.mmap(file.fileno(), SIZE_BYTES), self._camera.width_px, self._camera.height_px
            )
        self._shared.yuyv[:, :, 1] = _NO_COLOUR
        self._plant = plant
        self._half_exposure_ns = round(self._camera.exposure_ms * 5e5)
        self._tip = MockCamera(config, plant, CAMERA, seed)
        self._tip.scene.prepare()
        board = Checkerboard(CORNERS[0] + 1, CORNERS[1] + 1, SQUARE_MM * 1e-3)
        self._in_hand = _held(shown_boards(config, CAMERA, board, seed))
        self._on_the_base = _standing(config, board, seed)
        self._index = 0
        self._due_ns = 0

    def advance(self) -> None:
        """Expose, once the plant has come to the end of the next exposure."""
        header = self._shared.header
        header["chamber_pa"] = self._plant.pressure_pa
        period_ns = int(header["period_us"][0]) * 1000
        t_ns = self._plant.t_ns
        if not period_ns or t_ns < self._due_ns:
            return
        self._due_ns = max(self._due_ns + period_ns, t_ns - t_ns % period_ns + period_ns)
        middle_ns = t_ns - self._half_exposure_ns
        image, tip_m = self._seen(Subject(int(header["subject"][0])), middle_ns)
        header["sequence"] += 1
        header["t_ns"] = middle_ns
        header["tip_m"] = tip_m
        self._shared.yuyv[:, :, 0] = _VIDEO_RANGE[image]
        header["sequence"] += 1
        self._index += 1

    def _seen(self, subject: Subject, t_ns: int) -> tuple[Image, NDArray[np.float64]]:
        if subject is Subject.BOARD_IN_HAND:
            return next(self._in_hand), np.full(3, np.nan)
        if subject is Subject.BOARD_ON_THE_BASE:
            return next(self._on_the_base), np.full(3, np.nan)
        frame = self._tip.frame_at(self._index, t_ns)
        return frame.image, frame.truth_m


def _held(pictures: Iterator[Image]) -> Iterator[Image]:
    for picture in pictures:
        for _ in range(HELD_PICTURES):
            yield picture


def _standing(config: RigConfig, board: Checkerboard, seed: int) -> Iterator[Image]:
    assert config.simulator is not None
    assert config.simulator.scene is not None
    camera, truth = config.as_built.cameras[CAMERA], config.simulator.scene
    scene = Scene(
        board,
        lens_of(camera),
        (camera.width_px, camera.height_px),
        ImageDegradation(truth.blur_px, truth.noise_grey, truth.lighting),
        seed + 1,
    )
    pose = camera_in_base(camera).inverse() @ BOARD_ON_THE_BASE
    index = 0
    while True:
        yield scene.render(pose, pose, pose, index)
        index += 1
