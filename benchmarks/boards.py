"""Boards of which a part is covered: error and coverage, for the tables of docs/validation/vision.md.

    python -m benchmarks.boards [--poses 1000] [--seed 0] [--only charuco]

Every pose is measured anew from one picture: with the whole board, with a third of its area under a matt patch anywhere
on it, and with a third under a strip along one of its sides, which shortens the board. One camera of 1280x960 pixels
looks at the board from 0.35 to 0.5 m. The tool centre point lies 30 mm behind the board. Lens and place of the camera
are exact.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.other_renderer import PRINT_PX, BoardPose, OtherRenderer
from calibration.vision.board import Board
from calibration.vision.charuco import CharucoBoard
from calibration.vision.lens import Lens
from calibration.vision.marker_board import LEAST_CORNERS
from calibration.vision.tag_grid import TagGrid
from calibration.vision.tracker import Tracker
from calibration.vision.transforms import RigidTransform
from rig.simulator.print_rendering import Cover
from rig.simulator.scene import Optics, Scene

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]
Draw = Callable[[RigidTransform, int], Image]

TIP_IN_BOARD = np.array([0.0, 0.0, -0.030])
CHI2_95_3 = 7.815
NORMAL_95 = 1.95996
SIZE = (1280, 960)
LENS = Lens.of(1240, 1240, 643, 478, (-0.1, 0.05, 0.0003, -0.0002, 0.0))
FACING = np.diag([1.0, -1.0, -1.0])
BOARDS: dict[str, Board] = {
    "charuco 6x5": CharucoBoard(6, 5, 0.010, 0.007, "4X4_50"),
    "charuco 9x8": CharucoBoard(9, 8, 0.008, 0.0056, "4X4_50"),
    "tags": TagGrid(3, 2, 0.016, 0.004, "APRILTAG_36h11"),
    "one tag": TagGrid(1, 1, 0.040, 0.010, "APRILTAG_36h11"),
}
_THIRD, _OUT = 1 / 3, 0.3
STRIPS = (
    Cover(-_OUT, -_OUT, _THIRD, 1 + _OUT),
    Cover(1 - _THIRD, -_OUT, 1 + _OUT, 1 + _OUT),
    Cover(-_OUT, -_OUT, 1 + _OUT, _THIRD),
    Cover(-_OUT, 1 - _THIRD, 1 + _OUT, 1 + _OUT),
)
_PATCHES = 20


def patches(seed: int) -> tuple[Cover, ...]:
    """Patches of a third of the board's area and of its shape, anywhere on it."""
    rng = np.random.default_rng([seed, 1])
    edge = float(np.sqrt(_THIRD))
    places = rng.uniform(0, 1 - edge, (_PATCHES, 2))
    return tuple(Cover(float(x), float(y), float(x) + edge, float(y) + edge) for x, y in places)


LOOKS = {
    "second, lens blur": BoardPose(blur_px=0.5, noise_grey=2.0),
    "second, blurred after the pixels, JPEG 90": BoardPose(pixel_blur_px=0.6, noise_grey=2.0, jpeg=90),
}


@dataclass(frozen=True)
class BoardErrors:
    """Errors (n, 3) [m] and covariances (n, 3, 3) of the tool centre point, and errors of the board's centre (n, 3).

    NaN where no pose was measured; `lost` are so many.
    """

    tip_m: Floats
    covariance_m2: Floats
    centre_m: Floats
    lost: int

    def held(self) -> tuple[float, float]:
        """Shares of the single axes' 95 % intervals and of the 95 % ellipsoids that hold the truth."""
        measured = np.isfinite(self.tip_m[:, 0])
        tip_m, covariance_m2 = self.tip_m[measured], self.covariance_m2[measured]
        std = np.sqrt(np.diagonal(covariance_m2, axis1=1, axis2=2))
        squares = np.sum(tip_m * np.linalg.solve(covariance_m2, tip_m[:, :, None])[:, :, 0], axis=1)
        return float(np.mean(np.abs(tip_m) < NORMAL_95 * std)), float(np.mean(squares < CHI2_95_3))


def poses(count: int, seed: int) -> Iterator[RigidTransform]:
    """The board before the camera, tilted 20 to 35 deg about any axis in its plane and rolled by any angle."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        about = rng.uniform(0, 2 * np.pi)
        tilt = np.deg2rad(rng.uniform(20, 35)) * np.array([np.cos(about), np.sin(about), 0.0])
        roll = RigidTransform.from_vectors((0.0, 0.0, rng.uniform(-np.pi, np.pi)), (0.0, 0.0, 0.0)).rotation
        back = RigidTransform.from_vectors(tilt, (0.0, 0.0, 0.0)).rotation
        z = rng.uniform(0.35, 0.5)
        yield RigidTransform(roll @ FACING @ back, z * np.array([rng.uniform(-0.3, 0.3), rng.uniform(-0.2, 0.2), 1.0]))


def ours(board: Board, cover: Cover | None, seed: int) -> Draw:
    """The mock camera's renderer."""
    scene = Scene(board, LENS, SIZE, Optics(0.6, 2.0), seed, cover)
    return lambda seen, k: scene.render(seen, seen, seen, k)


def others(board: Board, cover: Cover | None, look: BoardPose, seed: int) -> Draw:
    """The second renderer, with a print that OpenCV draws."""
    drawn = printed(board)
    if cover is not None:
        height, width = drawn.shape
        rows = slice(max(0, round(cover.top * height)), round(cover.bottom * height))
        drawn[rows, max(0, round(cover.left * width)) : round(cover.right * width)] = 90
    renderer = OtherRenderer(board.extent, board.unit_m, LENS.matrix, LENS.distortion, SIZE, look, seed, drawn)
    return lambda seen, _: renderer.picture(seen.rotation, seen.translation_m)


def renderers(board: Board, seed: int) -> dict[str, Callable[[Cover | None], Draw]]:
    """What draws a board, by name."""

    def second(look: BoardPose) -> Callable[[Cover | None], Draw]:
        return lambda cover: others(board, cover, look, seed)

    return {"mock camera": lambda cover: ours(board, cover, seed)} | {n: second(look) for n, look in LOOKS.items()}


def printed(board: Board) -> Image:
    """The print, PRINT_PX pixels to a unit, as OpenCV draws it."""
    size = tuple(round(PRINT_PX * n) for n in board.extent)
    if isinstance(board, CharucoBoard):
        family = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{board.dictionary}"))
        squares = (board.squares_x, board.squares_y)
        drawn = cv2.aruco.CharucoBoard(squares, board.square_m, board.marker_m, family).generateImage(size)
    else:
        assert isinstance(board, TagGrid)
        family = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{board.dictionary}"))
        grid = cv2.aruco.GridBoard((board.tags_x, board.tags_y), board.tag_m, board.gap_m, family)
        drawn = grid.generateImage(size)
    return np.array(drawn, dtype=np.uint8)


def measure(board: Board, where: list[RigidTransform], draws: list[Draw]) -> BoardErrors:
    """Measure every pose anew; pose k is drawn by `draws[k % n]`."""
    tips, covariances, centres = [], [], []
    lost = 0
    for k, pose in enumerate(where):
        found = Tracker(board, LENS).detect(draws[k % len(draws)](pose, k)).pose
        if found is None:
            lost += 1
            tips.append(np.full(3, np.nan))
            covariances.append(np.full((3, 3), np.nan))
            centres.append(np.full(3, np.nan))
            continue
        tip, covariance = found.point(TIP_IN_BOARD)
        tips.append(tip - pose.apply(TIP_IN_BOARD))
        covariances.append(covariance)
        centres.append(found.translation_m - pose.translation_m)
    return BoardErrors(np.array(tips), np.array(covariances), np.array(centres), lost)


def mean_um(errors_m: Floats) -> float:
    """Mean length [um] of errors (n, 3), of those that are finite."""
    return float(np.nanmean(np.linalg.norm(errors_m, axis=1))) * 1e6


def row(name: str, found: BoardErrors, whole: BoardErrors) -> str:
    """One line of the table; mean errors in um, and their ratio to those of the whole board."""
    centre, tip = mean_um(found.centre_m), mean_um(found.tip_m)
    ratios = f"{centre / mean_um(whole.centre_m):.2f} / {tip / mean_um(whole.tip_m):.2f}"
    axis, ellipsoid = found.held()
    return f"| {name} | {centre:.0f} / {tip:.0f} | {ratios} | {100 * axis:.1f} / {100 * ellipsoid:.1f} | {found.lost} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--poses", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="part of a board's name")
    asked = parser.parse_args()
    cv2.setNumThreads(1)
    print("| board, renderer | mean error of centre / tip [um] | ratio to whole | held axes / ellipsoid [%] | lost |")
    print("|---|---|---|---|---|")
    where = list(poses(asked.poses, asked.seed))
    for name, board in BOARDS.items():
        if asked.only not in name:
            continue
        covers: dict[str, tuple[Cover | None, ...]] = {"whole": (None,)}
        if len(board.corners_m) > LEAST_CORNERS:
            covers |= {"patch": patches(asked.seed), "strip": STRIPS}
        for renderer, draw in renderers(board, asked.seed).items():
            whole = None
            for cover_name, chosen in covers.items():
                found = measure(board, where, [draw(cover) for cover in chosen])
                whole = whole or found
                print(row(f"{name}, {cover_name}, {renderer}", found, whole), flush=True)


if __name__ == "__main__":
    main()
