"""Boards of which a part is covered: error, Cramer-Rao bound and coverage, for `benchmarks.vision`.

Every pose is measured anew from one picture: with the whole board, with a third of its area under a matt patch anywhere
on it, and with a third under a strip along each of its sides, which shortens the board. One camera of 1280x960 pixels
looks at the board from 0.35 to 0.5 m. The tool centre point lies 30 mm behind the board. Lens and place of the camera
are exact.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.support.other_renderer import PRINT_PX, BoardPose, OtherRenderer
from calibration.images import Image
from calibration.vision.board import Board
from calibration.vision.charuco import CharucoBoard
from calibration.vision.lens import Lens
from calibration.vision.marker_board import LEAST_CORNERS
from calibration.vision.tag_grid import TagGrid
from calibration.vision.tracker import BoardTracker
from calibration.vision.transforms import RigidTransform
from model.arrays import Array
from rig.simulator.board_rendering import print_table, table_renderer
from rig.simulator.scene import ImageDegradation, Scene

Draw = Callable[[RigidTransform, int], Image]

TIP_IN_BOARD = np.array([0.0, 0.0, -0.030])
CHI2_95_3 = 7.815
NORMAL_95 = 1.95996
SIZE = (1280, 960)
LENS = Lens.of(1240, 1240, 643, 478, (-0.1, 0.05, 0.0003, -0.0002, 0.0))
FACING = np.diag([1.0, -1.0, -1.0])
BOARDS: dict[str, Board] = {
    "charuco 6x5": CharucoBoard(6, 5, 0.010, 0.007, "4X4_50"),
    "charuco 5x5": CharucoBoard(5, 5, 0.012, 0.0084, "4X4_50"),
    "charuco 8x5": CharucoBoard(8, 5, 0.008, 0.0056, "4X4_50"),
    "charuco 8x8": CharucoBoard(8, 8, 0.008, 0.0056, "4X4_50"),
    "charuco 9x8": CharucoBoard(9, 8, 0.008, 0.0056, "4X4_50"),
    "tags": TagGrid(3, 2, 0.016, 0.004, "APRILTAG_36h11"),
    "one tag": TagGrid(1, 1, 0.040, 0.010, "APRILTAG_36h11"),
}
COVER_REFLECTANCE = 0.35


@dataclass(frozen=True)
class Occlusion:
    """A matt strip on the board, between `left`, `top`, `right` and `bottom` in shares of the print's extent."""

    left: float
    top: float
    right: float
    bottom: float


_THIRD, _OUT = 1 / 3, 0.3
STRIPS = {
    "left": Occlusion(-_OUT, -_OUT, _THIRD, 1 + _OUT),
    "right": Occlusion(1 - _THIRD, -_OUT, 1 + _OUT, 1 + _OUT),
    "top": Occlusion(-_OUT, -_OUT, 1 + _OUT, _THIRD),
    "bottom": Occlusion(-_OUT, 1 - _THIRD, 1 + _OUT, 1 + _OUT),
}
_ON_EDGE = 0.05
"""Distance in squares from a cover within which a corner shows half of its surroundings."""
_PATCHES = 20


def patches(seed: int) -> tuple[Occlusion, ...]:
    """Patches of a third of the board's area and of its shape, anywhere on it."""
    rng = np.random.default_rng([seed, 1])
    edge = float(np.sqrt(_THIRD))
    places = rng.uniform(0, 1 - edge, (_PATCHES, 2))
    return tuple(Occlusion(float(x), float(y), float(x) + edge, float(y) + edge) for x, y in places)


LOOKS = {
    "second, lens blur": BoardPose(blur_px=0.5, noise_grey=2.0),
    "second, blurred after the pixels, JPEG 90": BoardPose(pixel_blur_px=0.6, noise_grey=2.0, jpeg=90),
}


@dataclass(frozen=True)
class BoardErrors:
    """Errors (n, 3) [m] and covariances (n, 3, 3) of the tool centre point, NaN where no pose was measured.

    `bound` (n,) is its Cramer-Rao bound from the corners that no occlusion hides, in m per pixel of error of a corner.
    """

    tip_m: Array
    covariance_m2: Array
    bound: Array

    @property
    def lost(self) -> int:
        """How many poses were not measured."""
        return int(np.isnan(self.tip_m[:, 0]).sum())

    def sizes(self) -> Array:
        """Mean, median and root mean square of the lengths of the errors, and the stated root mean square, in um."""
        length = np.linalg.norm(self.tip_m, axis=1)
        stated = np.sqrt(np.nanmean(np.trace(self.covariance_m2, axis1=1, axis2=2)))
        rms = np.sqrt(np.nanmean(length**2))
        return 1e6 * np.array([np.nanmean(length), np.nanmedian(length), rms, stated])

    def rms_bound(self) -> float:
        """Root mean square of the bound over the poses that were measured."""
        return float(np.sqrt(np.mean(self.bound[np.isfinite(self.tip_m[:, 0])] ** 2)))

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


def ours(board: Board, occlusion: Occlusion | None, seed: int) -> Draw:
    """The mock camera's renderer."""
    scene = Scene(board, LENS, SIZE, ImageDegradation(0.6, 2.0), seed)
    if occlusion is not None:
        scene.board.render = table_renderer(*covered_table(board, occlusion))
    return lambda seen, k: scene.render(seen, seen, seen, k)


def covered_table(board: Board, occlusion: Occlusion) -> tuple[Array, Array, Array]:
    """The table of a print, a part of which is covered by a matt strip."""
    (width, height), (across, down, table) = board.extent, print_table(board)
    across, table = _split(across, table, occlusion.left * width, occlusion.right * width)
    down, rows = _split(down, table.T, occlusion.top * height, occlusion.bottom * height)
    table = np.ascontiguousarray(rows.T)
    x, y = _middles(across), _middles(down)
    inside_x = (x > occlusion.left * width) & (x < occlusion.right * width)
    table[np.ix_((y > occlusion.top * height) & (y < occlusion.bottom * height), inside_x)] = COVER_REFLECTANCE
    return across, down, table


def _split(lines: Array, columns: Array, first: float, last: float) -> tuple[Array, Array]:
    """Lines and the columns of the table between them, with two more lines."""
    split = np.unique(np.concatenate([lines, [first, last]]))
    return split, columns[:, np.searchsorted(lines, np.concatenate([[-np.inf], split]), side="right")]


def _middles(lines: Array) -> Array:
    """A place in each of the cells that the lines part, also before the first and after the last."""
    return np.concatenate([[-np.inf], (lines[1:] + lines[:-1]) / 2, [np.inf]])


def others(board: Board, occlusion: Occlusion | None, look: BoardPose, seed: int) -> Draw:
    """The second renderer, with a print that OpenCV draws."""
    drawn = printed(board)
    if occlusion is not None:
        height, width = drawn.shape
        rows = slice(max(0, round(occlusion.top * height)), round(occlusion.bottom * height))
        drawn[rows, max(0, round(occlusion.left * width)) : round(occlusion.right * width)] = 90
    renderer = OtherRenderer(board.extent, board.unit_m, LENS.matrix, LENS.distortion, SIZE, look, seed, drawn)
    return lambda seen, _: renderer.picture(seen.rotation, seen.translation_m)


def renderers(board: Board, seed: int) -> dict[str, Callable[[Occlusion | None], Draw]]:
    """What draws a board, by name."""

    def second(look: BoardPose) -> Callable[[Occlusion | None], Draw]:
        return lambda occlusion: others(board, occlusion, look, seed)

    mock = {"mock camera": lambda occlusion: ours(board, occlusion, seed)}
    return mock | {n: second(look) for n, look in LOOKS.items()}


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


def free_corners(board: Board, occlusion: Occlusion | None) -> NDArray[np.bool_]:
    """Which corners (n,) an occlusion does not hide; one on its edge is no saddle any more, and counts as hidden."""
    if occlusion is None:
        return np.ones(len(board.corners_m), dtype=np.bool_)
    width, height = board.extent
    across = 0.5 * width + board.corners_m[:, 0] / board.unit_m
    down = 0.5 * height - board.corners_m[:, 1] / board.unit_m
    beside = (across < occlusion.left * width - _ON_EDGE) | (across > occlusion.right * width + _ON_EDGE)
    above: NDArray[np.bool_] = (down < occlusion.top * height - _ON_EDGE) | (
        down > occlusion.bottom * height + _ON_EDGE
    )
    return beside | above


def tip_bound(board: Board, pose: RigidTransform, free: NDArray[np.bool_]) -> float:
    """Cramer-Rao bound [m/px] of the tip: its standard error if each free corner errs by one pixel on both axes."""
    vector = cv2.Rodrigues(pose.rotation)[0]
    slopes = cv2.projectPoints(board.corners_m[free], vector, pose.translation_m, LENS.matrix, LENS.distortion)[1]
    pixels = slopes[:, :6]
    turned = cv2.Rodrigues(vector)[1].reshape(3, 3, 3) @ TIP_IN_BOARD
    by_pose = np.hstack([turned.T, np.eye(3)])
    covariance = by_pose @ np.linalg.inv(pixels.T @ pixels) @ by_pose.T
    return float(np.sqrt(np.trace(covariance)))


def measure(
    board: Board,
    where: list[RigidTransform],
    occlusions: tuple[Occlusion | None, ...],
    draw: Callable[[Occlusion | None], Draw],
) -> BoardErrors:
    """Measure every pose anew; the occlusions take turns."""
    draws = [draw(occlusion) for occlusion in occlusions]
    free = [free_corners(board, occlusion) for occlusion in occlusions]
    tips, covariances, bounds = [], [], []
    for k, pose in enumerate(where):
        found = BoardTracker(board, LENS).detect(draws[k % len(draws)](pose, k)).pose
        tip, covariance = np.full(3, np.nan), np.full((3, 3), np.nan)
        if found is not None:
            measured, covariance = found.point(TIP_IN_BOARD)
            tip = measured - pose.apply(TIP_IN_BOARD)
        tips.append(tip)
        covariances.append(covariance)
        bounds.append(tip_bound(board, pose, free[k % len(free)]))
    return BoardErrors(np.array(tips), np.array(covariances), np.array(bounds))


def covers(board: Board, seed: int) -> dict[str, tuple[Occlusion | None, ...]]:
    """What covers a board, by name; the occlusions of one name take turns."""
    whole: dict[str, tuple[Occlusion | None, ...]] = {"whole": (None,)}
    if len(board.corners_m) <= LEAST_CORNERS:
        return whole
    return whole | {"patch": patches(seed)} | {side: (strip,) for side, strip in STRIPS.items()}


def bound_row(name: str, board: Board, where: list[RigidTransform]) -> str:
    """Cramer-Rao bound of the whole board in um for corners that err by 0.1 pixel, and its ratios by covered side."""

    def bound(occlusion: Occlusion | None) -> float:
        free = free_corners(board, occlusion)
        if free.sum() < LEAST_CORNERS:
            return float("inf")
        return float(np.sqrt(np.mean([tip_bound(board, pose, free) ** 2 for pose in where])))

    whole = bound(None)
    sides = " | ".join(f"{bound(strip) / whole:.2f}" for strip in STRIPS.values())
    return f"| {name} | {len(board.corners_m)} | {1e5 * whole:.0f} | {sides} |"


def row(name: str, found: BoardErrors, whole: BoardErrors) -> str:
    """One line of the table; the ratios are to the whole board."""
    sizes = " / ".join(f"{size:.1f}" for size in found.sizes())
    ratios = " / ".join(f"{ratio:.2f}" for ratio in found.sizes()[:3] / whole.sizes()[:3])
    axis, ellipsoid = found.held()
    bound = found.rms_bound() / whole.rms_bound()
    return f"| {name} | {sizes} | {ratios} | {bound:.2f} | {100 * axis:.1f} / {100 * ellipsoid:.1f} | {found.lost} |"


def print_bounds(poses_drawn: int, seed: int, only: str) -> None:
    """Print the Cramer-Rao bounds by covered side, without pictures."""
    where = list(poses(poses_drawn, seed))
    print("| board | corners | bound of the whole board [um] | left | right | top | bottom |")
    print("|---|---|---|---|---|---|---|")
    for name, board in BOARDS.items():
        if only in name:
            print(bound_row(name, board, where), flush=True)


def print_errors(poses_drawn: int, seed: int, only: str) -> None:
    """Print error and coverage of each board, whole and with a part covered, by each renderer."""
    where = list(poses(poses_drawn, seed))
    print(
        "| board, renderer | error of the tip: mean / median / rms / stated rms [um] "
        "| ratio to whole: mean / median / rms | ratio of the bounds | held axes / ellipsoid [%] | lost |"
    )
    print("|---|---|---|---|---|---|")
    for name, board in BOARDS.items():
        if only not in name:
            continue
        for renderer, draw in renderers(board, seed).items():
            whole = None
            for occlusion_name, chosen in covers(board, seed).items():
                found = measure(board, where, chosen, draw)
                whole = whole or found
                print(row(f"{name}, {occlusion_name}, {renderer}", found, whole), flush=True)
