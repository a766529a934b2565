"""A simulated operator: holds the calibration board before the mock camera and turns the end cap."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calibration.images import Image
from calibration.vision.board import Board
from calibration.vision.transforms import RigidTransform
from model.statics import statics
from rig.config.arm_model import true_arm
from rig.config.optics import lens_of
from rig.config.schema import RigConfig
from rig.simulator.mock_camera import MockCamera
from rig.simulator.scene import ImageDegradation, Scene
from rig.simulator.tip_pose import TipPose

_FACING = np.diag([1.0, -1.0, -1.0])
_MOST_LEAN_DEG = 32.0
_FILLS = (0.3, 0.55)
_HELD_FRAMES = 3
_TREMBLE_M = 2e-5
_TURN_STD_DEG = 1.5


def shown_boards(config: RigConfig, camera: str, board: Board, seed: int) -> Iterator[Image]:
    """Pictures of a hand-held board at varied positions, distances and tilts, each held for a while."""
    assert config.simulator is not None
    assert config.simulator.scene is not None
    chosen, truth = config.as_built.cameras[camera], config.simulator.scene
    lens, size = lens_of(chosen), (chosen.width_px, chosen.height_px)
    scene = Scene(board, lens, size, ImageDegradation(truth.blur_px, truth.noise_grey, truth.lighting), seed)
    rng = np.random.default_rng([seed, 0xCA11])
    extent = np.ptp(board.corners_m[:, :2], axis=0) + board.unit_m
    index = 0
    while True:
        # The position in the picture is chosen first: the outline must lie inside.
        fills = rng.uniform(*_FILLS)
        distance = chosen.lens.fx_px * float(extent.max()) / (fills * chosen.width_px)
        lean = RigidTransform.from_vectors(
            np.deg2rad(rng.uniform(-_MOST_LEAN_DEG, _MOST_LEAN_DEG, 3)), (0, 0, 0)
        ).rotation
        margin = (1.3 * extent / 2 / distance * (lens.matrix[0, 0], lens.matrix[1, 1])).max()
        u, v = (rng.uniform(min(margin, s / 2), max(s - margin, s / 2)) for s in size)
        ray = lens.rays(np.array([[u, v]]))[0]
        for _ in range(_HELD_FRAMES):
            place = distance * np.array([*ray, 1.0]) + rng.normal(0, _TREMBLE_M, 3)
            pose = RigidTransform(lean @ _FACING, place)
            yield scene.render(pose, pose, pose, index)
            index += 1


class RotatedTip:
    """A source of tip poses: the arm at rest, its end cap turned about the central axis by hand."""

    def __init__(self, config: RigConfig) -> None:
        shape = statics(true_arm(config.as_built), np.zeros(config.actuators))
        self._position_m, self._rotation = shape.tip_m, shape.tip_rotation
        self.turned_deg = 0.0

    def pose_at(self, t_ns: int) -> TipPose:
        turn = RigidTransform.from_vectors((0.0, 0.0, np.deg2rad(self.turned_deg)), (0, 0, 0)).rotation
        return TipPose(t_ns, self._position_m, np.asarray(self._rotation @ turn))


class RotatedCapCamera:
    """Pictures of the mock camera while the cap is turned by hand, with a random error of the angle."""

    def __init__(self, config: RigConfig, camera: str, seed: int) -> None:
        self._tip = RotatedTip(config)
        self._camera = MockCamera(config, self._tip, camera, seed)
        self._rng = np.random.default_rng([seed, 0x7001])
        self._index = 0

    def picture(self, turned_deg: float) -> Image:
        """A picture with the cap turned by about the requested angle; exactly straight for 0."""
        self._tip.turned_deg = turned_deg + (self._rng.normal(0, _TURN_STD_DEG) if turned_deg else 0.0)
        self._index += 1
        return self._camera.frame_at(self._index, 10_000_000_000 + self._index).image
