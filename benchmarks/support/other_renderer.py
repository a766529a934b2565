"""A second renderer of checkerboards that shares nothing with the mock camera's: measuring must not depend on either.

The print is drawn once, many pixels to a square. A picture samples it on a grid finer than its pixels, through the
lens, with OpenCV's remap; the samples of a pixel are averaged. Then comes what a camera and a file add after the
pixels: a blur on the pixels' own grid, vignetting, gamma, noise that grows with the light, whole grey levels, JPEG.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.images import Image
from model.arrays import Array

PRINT_PX = 64
"""Pixels of the print to a square."""
_MARGIN_SQUARES = 1.5
_SURROUND = 0.35


@dataclass(frozen=True)
class BoardPose:
    """What a camera makes of light: `blur_px` of the optics, before the pixels, and `pixel_blur_px` after them;
    `noise_grey` at full light, of which `shot_share` grows with its root; `gamma`; `vignetting` at the corners;
    `jpeg` quality, 0 for none; `finer` samples to a pixel each way.
    """

    blur_px: float = 0.0
    pixel_blur_px: float = 0.0
    noise_grey: float = 1.5
    shot_share: float = 0.5
    gamma: float = 1.0
    vignetting: float = 0.2
    jpeg: int = 0
    finer: int = 5
    white: float = 0.85
    black: float = 0.08


class OtherRenderer:
    """Pictures (height, width) of a board of `squares` (across, down) of `square_m` through a distorting lens."""

    def __init__(
        self,
        squares: tuple[float, float],
        square_m: float,
        matrix: Array,
        distortion: Array,
        size: tuple[int, int],
        look: BoardPose,
        seed: int,
        drawn: Image | None = None,
    ) -> None:
        """`drawn` is the print, PRINT_PX pixels to a square; None: a checkerboard."""
        self._look, self._size = look, size
        self._square_m, self._squares = square_m, squares
        self._matrix, self._distortion = matrix, distortion
        self._rng = np.random.default_rng(seed)
        across, down = squares
        if drawn is None:
            checks = (np.add.outer(np.arange(down), np.arange(across)) % 2).astype(np.float32)
            board = np.kron(checks, np.ones((PRINT_PX, PRINT_PX), np.float32))
        else:
            board = drawn.astype(np.float32) / 255
        rim = round(_MARGIN_SQUARES * PRINT_PX)
        grey = look.black + (look.white - look.black) * np.pad(board, rim, constant_values=1.0)
        self._print = grey.astype(np.float32)
        width, height = size
        y, x = np.ogrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
        self._fall_off = (1 - look.vignetting * (x**2 + y**2) / 2).astype(np.float32)
        # What lies round the board is drawn once: its noise is not that of each picture.
        self._behind = self._developed(np.full((height, width), _SURROUND, np.float32), self._fall_off)

    def picture(self, rotation: Array, translation: Array) -> Image:
        """The board's frame (centre, x right, y up, z to the viewer) stands at this pose before the camera."""
        look = self._look
        image = self._behind.copy()
        x0, y0, x1, y1 = self._box(rotation, translation)
        if x1 > x0 and y1 > y0:
            n = look.finer
            u = (np.arange((x1 - x0) * n) + 0.5) / n - 0.5 + x0
            v = (np.arange((y1 - y0) * n) + 0.5) / n - 0.5 + y0
            where = self._to_print(u, v, rotation, translation)
            fine = cv2.remap(
                self._print, where[0], where[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=_SURROUND
            )
            if look.blur_px > 0:
                fine = cv2.GaussianBlur(fine, (0, 0), look.blur_px * n)
            light = np.asarray(cv2.resize(fine, (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA), np.float32)
            if look.pixel_blur_px > 0:
                light = np.asarray(cv2.GaussianBlur(light, (0, 0), look.pixel_blur_px), np.float32)
            image[y0:y1, x0:x1] = self._developed(light, self._fall_off[y0:y1, x0:x1])
        if look.jpeg:
            _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, look.jpeg])
            image = np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), np.uint8)
        return image

    def _developed(self, light: NDArray[np.float32], fall_off: NDArray[np.float32]) -> Image:
        """Grey levels of light (0 to 1), with what the sensor adds."""
        look = self._look
        light = light * fall_off
        grey = 255 * light ** (1 / look.gamma)
        std = look.noise_grey * np.sqrt(1 - look.shot_share + look.shot_share * light)
        grey = grey + std * self._rng.standard_normal(grey.shape, dtype=np.float32)
        return np.clip(np.rint(grey), 0, 255).astype(np.uint8)

    def _box(self, rotation: Array, translation: Array) -> tuple[int, int, int, int]:
        """Pixels that the print may touch."""
        across, down = ((n / 2 + _MARGIN_SQUARES) * self._square_m for n in self._squares)
        t = np.linspace(-1, 1, 9)
        rim = np.concatenate([np.stack([t * across, s * down + 0 * t, 0 * t], 1) for s in (-1, 1)])
        rim = np.concatenate([rim, *(np.stack([s * across + 0 * t, t * down, 0 * t], 1) for s in (-1, 1))])
        vector, _ = cv2.Rodrigues(rotation)
        pixels, _ = cv2.projectPoints(rim, vector, translation, self._matrix, self._distortion)
        margin = 6 + 5 * (self._look.blur_px + self._look.pixel_blur_px)
        low = np.maximum(np.floor(pixels[:, 0].min(0) - margin), 0).astype(int)
        high = np.minimum(np.ceil(pixels[:, 0].max(0) + margin) + 1, self._size).astype(int)
        return int(low[0]), int(low[1]), int(high[0]), int(high[1])

    def _to_print(
        self, u: Array, v: Array, rotation: Array, translation: Array
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Where in the print the light of pixels (v, u) comes from."""
        # Undistortion is smooth: it is computed on a coarse grid and interpolated.
        cu, cv = np.linspace(u[0], u[-1], 24), np.linspace(v[0], v[-1], 24)
        grid = np.stack(np.meshgrid(cu, cv), axis=-1).reshape(-1, 1, 2)
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-12)
        rays = cv2.undistortPointsIter(grid, self._matrix, self._distortion, None, None, criteria)  # type: ignore[call-overload]
        to_board = np.linalg.inv(np.column_stack([rotation[:, 0], rotation[:, 1], translation]))
        on_board = np.column_stack([rays[:, 0], np.ones(len(rays))]) @ to_board.T
        metres = (on_board[:, :2] / on_board[:, 2:]).reshape(24, 24, 2)
        across, down = self._squares
        rim = _MARGIN_SQUARES
        px = (metres[..., 0] / self._square_m + across / 2 + rim) * PRINT_PX - 0.5
        py = (down / 2 - metres[..., 1] / self._square_m + rim) * PRINT_PX - 0.5
        return tuple(_spread(p, cv, cu, v, u) for p in (px, py))  # type: ignore[return-value]


def _spread(values: Array, rows: Array, columns: Array, v: Array, u: Array) -> NDArray[np.float32]:
    from scipy.interpolate import RectBivariateSpline

    return RectBivariateSpline(rows, columns, values, kx=3, ky=3)(v, u).astype(np.float32)
