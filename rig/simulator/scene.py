"""The picture behind the mock camera: the board through a distorting lens, with blur, motion and noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.images import Image
from calibration.vision.board import Board
from calibration.vision.lens import Lens
from calibration.vision.projection import extent
from calibration.vision.transforms import RigidTransform
from model.arrays import Array
from rig.simulator.board_rendering import renderer
from rig.simulator.checkerboard_rendering import FINE, ExposedView, shrink

Singles = NDArray[np.float32]

_SAMPLES = 64
_NOISE_SPARE = (61, 83)
"""How far the field of noise is moved between pictures."""
_NOISE_PLACES = 4096
_BACKDROPS = 32
"""Noisy pictures of the backdrop, in turn behind the board, whose own noise is that of every picture."""
_NEAREST_M = 0.01
_RAYS_SPARE_PX = 80


@dataclass(frozen=True)
class ImageDegradation:
    """What the picture suffers: `blur_px` (Gaussian, standard deviation), `noise_grey` (standard deviation of 256
    levels), `lighting` (share of full scale of a white surface where the light is best).
    """

    blur_px: float
    noise_grey: float
    lighting: float = 0.9


class RenderedBoard:
    """A board that a scene can show."""

    def __init__(self, board: Board) -> None:
        self.outline = _outline(board)
        self.render = renderer(board)
        # A point at (a, d) units lies at x = (a - nx/2) s, y = (ny/2 - d) s on the board.
        width_units, height_units = board.extent
        self.squares = np.array(
            [
                [board.unit_m, 0.0, -width_units / 2 * board.unit_m],
                [0.0, -board.unit_m, height_units / 2 * board.unit_m],
                [0.0, 0.0, 1.0],
            ]
        )


@dataclass(frozen=True)
class MovingBoard:
    """A board's frame in the camera's at the exposure's start, middle and end."""

    board: RenderedBoard
    opened: RigidTransform
    middle: RigidTransform
    closed: RigidTransform


class Scene:
    """One camera's view of the board; the same seed and frame index give the same picture, bit for bit."""

    def __init__(
        self, board: Board, lens: Lens, size: tuple[int, int], degradation: ImageDegradation, seed: int
    ) -> None:
        """`size` is (width, height) in pixels."""
        self.board, self._degradation = RenderedBoard(board), degradation
        self._lens = lens
        width, height = size
        self._rays = _PixelRays(lens, size)
        rng = np.random.default_rng([seed, 0xB0A2D])
        self._light = _light(size, degradation.lighting)
        self._backdrop = _backdrop(size, self._light, rng)
        noise = rng.standard_normal((height + _NOISE_SPARE[1], width + _NOISE_SPARE[0]), dtype=np.float32)
        self._noise = noise * np.float32(degradation.noise_grey)
        self._noise_places = rng.integers(0, _NOISE_SPARE, (_NOISE_PLACES, 2))
        self._backdrops: dict[int, Image] = {}
        self._samples = _sample_offsets()
        self._taps = _taps(degradation.blur_px)

    def prepare(self) -> None:
        """Find the rays of the whole picture and draw the backdrops, so that no frame in real time waits for them."""
        height, width = self._light.shape
        self._rays.covering((0, 0, width, height))
        for number in range(_BACKDROPS):
            self._noisy_backdrop(number)

    def render(
        self,
        opened: RigidTransform,
        middle: RigidTransform,
        closed: RigidTransform,
        index: int,
        others: Sequence[MovingBoard] = (),
    ) -> Image:
        """Render (height, width) uint8 of the board's frame in the camera's at the exposure's start, middle and end.

        `others` are further boards; a nearer one hides what is behind it.
        """
        # No two pictures in a row have the same backdrop: a picture that repeats is one of a frozen camera.
        image = self._noisy_backdrop((13 * index + 5 * (index // _BACKDROPS)) % _BACKDROPS).copy()
        boards = [MovingBoard(self.board, opened, middle, closed), *others]
        boards.sort(key=lambda one: -float(one.middle.translation_m[2]))
        for number, board in enumerate(boards):
            self._draw(board, image, index, self._backdrop if number == 0 else image.astype(np.float32))
        return image

    def _draw(self, moving: MovingBoard, image: Image, index: int, backdrop: Singles) -> None:
        """Draw a board into the picture; `backdrop` is what is behind it."""
        height, width = self._light.shape
        poses = (moving.opened, moving.middle, moving.closed)
        box = self._extent(moving.board, poses, width, height)
        if box is not None:
            x0, y0, x1, y1 = box
            at_open, at_middle, at_close = _to_squares(moving.board, poses)
            fine = np.empty(((y1 - y0) * FINE, (x1 - x0) * FINE), np.float32)
            view = ExposedView(
                (x0, y0),
                self._light,
                backdrop,
                self._rays.covering(box),
                at_middle,
                at_close - at_open,
                self._samples,
            )
            moving.board.render(fine, view)
            seen = np.empty((y1 - y0, x1 - x0), np.float32)
            shrink(fine, self._taps, seen)
            dx, dy = self._noise_places[index % _NOISE_PLACES].tolist()
            noise = self._noise[dy + y0 : dy + y1, dx + x0 : dx + x1]
            image[y0:y1, x0:x1] = cv2.add(seen, noise, dtype=cv2.CV_8U)

    def _noisy_backdrop(self, number: int) -> Image:
        """One of the pictures without a board, drawn when it is first needed."""
        if number not in self._backdrops:
            height, width = self._light.shape
            dx, dy = self._noise_places[-1 - number].tolist()
            noise = self._noise[dy : dy + height, dx : dx + width]
            self._backdrops[number] = np.asarray(cv2.add(self._backdrop, noise, dtype=cv2.CV_8U), dtype=np.uint8)
        return self._backdrops[number]

    def _extent(
        self, board: RenderedBoard, poses: tuple[RigidTransform, ...], width: int, height: int
    ) -> tuple[int, int, int, int] | None:
        """Pixels that the board with its margin may touch; None when it is out of the picture or behind."""
        rotations = np.array([pose.rotation for pose in poses])
        translations = np.array([pose.translation_m for pose in poses])
        bounds = np.empty((2, 2))
        lens = self._lens
        if extent(board.outline, rotations, translations, lens.matrix, lens.distortion, bounds) <= _NEAREST_M:
            return None
        margin = 4 + int(np.ceil(4 * self._degradation.blur_px))
        (left, top), (right, bottom) = bounds.tolist()
        x0, y0 = max(math.floor(left) - margin, 0), max(math.floor(top) - margin, 0)
        x1, y1 = min(math.ceil(right) + margin, width), min(math.ceil(bottom) + margin, height)
        return None if x1 - x0 < 2 or y1 - y0 < 2 else (x0, y0, x1, y1)


def _to_squares(board: RenderedBoard, poses: tuple[RigidTransform, ...]) -> Array:
    """Homographies (n, 3, 3) from rays to units across and down from the print's top left, last entries 1."""
    planes = np.empty((len(poses), 3, 3))
    for plane, pose in zip(planes, poses, strict=True):
        plane[:, :2], plane[:, 2] = pose.rotation[:, :2], pose.translation_m
    inverse = np.linalg.inv(planes @ board.squares)
    return np.asarray(inverse / inverse[:, 2:, 2:])


class _PixelRays:
    """Undistorted rays of the pixels, found where the board appears: those of a whole picture take some 75 ms."""

    def __init__(self, lens: Lens, size: tuple[int, int]) -> None:
        self._lens, self._size = lens, size
        self._rays = np.zeros((2, size[1] + 2, size[0] + 2))
        self._known = (*size, 0, 0)

    def covering(self, box: tuple[int, int, int, int]) -> Array:
        """Rays (2, height + 2, width + 2) of the picture with a rim of one pixel, valid in `box` and one pixel around.

        `box` is x0, y0, x1, y1 in pixels, the last two exclusive.
        """
        known = self._known
        if box[0] < known[0] or box[1] < known[1] or box[2] > known[2] or box[3] > known[3]:
            x0, y0 = (max(0, min(box[k], known[k]) - _RAYS_SPARE_PX) for k in (0, 1))
            x1, y1 = (min(self._size[k], max(box[k + 2], known[k + 2]) + _RAYS_SPARE_PX) for k in (0, 1))
            y, x = np.mgrid[y0 - 1 : y1 + 1, x0 - 1 : x1 + 1]
            rays = self._lens.rays(np.stack([x.ravel(), y.ravel()], axis=-1).astype(np.float64))
            self._rays[:, y0 : y1 + 2, x0 : x1 + 2] = rays.T.reshape(2, *x.shape)
            self._known = (x0, y0, x1, y1)
        return self._rays


def _outline(board: Board) -> Array:
    """Points (n, 3) along the rim of the white margin."""
    q, (nx, ny) = board.printed.margin, board.extent
    rim = np.linspace(0, 1, 5)
    across = np.concatenate([-q + rim * (nx + 2 * q)] * 2 + [np.full(5, -q), np.full(5, nx + q)])
    down = np.concatenate([np.full(5, -q), np.full(5, ny + q)] + [-q + rim * (ny + 2 * q)] * 2)
    return board.at(across, down)


def _taps(blur_px: float) -> Singles:
    """Weights of the fine grid's cells about a pixel's middle: the blur's bell, then the mean over the pixel."""
    reach = round(4 * blur_px * FINE)
    bell = np.exp(-0.5 * (np.arange(-reach, reach + 1) / max(blur_px * FINE, 1e-9)) ** 2)
    return np.convolve(bell / bell.sum(), np.full(FINE, 1 / FINE)).astype(np.float32)


def _light(size: tuple[int, int], lighting: float) -> Singles:
    """Grey of a white surface (height, width): falls off from one upper corner to the opposite one."""
    width, height = size
    y, x = np.mgrid[0:height, 0:width]
    ramp = (x / width + (height - y) / height) / 2
    return np.asarray(255.0 * lighting * (0.55 + 0.45 * ramp), dtype=np.float32)


def _backdrop(size: tuple[int, int], light: Singles, rng: np.random.Generator) -> Singles:
    """A laboratory out of focus: coarse patches, two uprights and a shelf."""
    width, height = size
    patches = rng.uniform(0.25, 0.5, (6, 8)).astype(np.float32)
    albedo = cv2.resize(patches, (width, height), interpolation=cv2.INTER_CUBIC)
    for centre in rng.uniform(0.05, 0.95, 2) * width:
        half = 0.02 * width
        albedo[:, max(int(centre - half), 0) : int(centre + half)] = 0.18
    shelf = int(rng.uniform(0.8, 0.95) * height)
    albedo[shelf : shelf + max(height // 60, 2)] = 0.65
    albedo = cv2.GaussianBlur(albedo, (0, 0), 0.004 * width)
    return np.asarray(albedo * light, dtype=np.float32)


def _sample_offsets() -> Singles:
    """Sample positions (3, k) in a pixel and in the exposure, each in -1/2..1/2, in opposite pairs.

    Pairs make every odd moment vanish, so that corners stay where they are.
    """
    # Generalised golden ratio in three dimensions: evenly spread for any number of points.
    g = 1.2207440846057596
    k = np.arange(1, _SAMPLES // 2 + 1)
    half = (0.5 + k * np.array([[1 / g], [1 / g**2], [1 / g**3]])) % 1.0 - 0.5
    return np.concatenate([half, -half], axis=1).astype(np.float32)
