"""The picture behind the mock camera: the checkerboard through a distorting lens, with blur, motion and noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.board import QUIET_SQUARES, Board
from calibration.frames import Rigid
from calibration.lens import Lens
from model.compiled import kernel

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Image = NDArray[np.uint8]

exact_kernel = partial(kernel, sources=(__file__,), fastmath=False)
fast_kernel = partial(kernel, sources=(__file__,), fastmath=True)

WHITE, DARK = 0.92, 0.10
_SAMPLES = 64
# The board is drawn on a grid so much finer, because a blur of less than a pixel is no blur on the pixels' own grid.
_FINE = 2
_LEAST_SLOPE = 1e-4
_NOISE_SPARE = (61, 83)


@dataclass(frozen=True)
class Optics:
    """What the picture suffers: `blur_px` (Gaussian, standard deviation), `noise_grey` (standard deviation of 256
    levels), `lighting` (share of full scale of a white surface where the light is best).
    """

    blur_px: float
    noise_grey: float
    lighting: float = 0.9


class Scene:
    """One camera's view of the board; the same seed and frame index give the same picture, bit for bit."""

    def __init__(self, board: Board, lens: Lens, size: tuple[int, int], optics: Optics, seed: int) -> None:
        """`size` is (width, height) in pixels."""
        self._board, self._optics, self._seed = board, optics, seed
        self._lens = lens
        width, height = size
        y, x = np.mgrid[-1 : height + 1, -1 : width + 1]
        rays = lens.rays(np.stack([x.ravel(), y.ravel()], axis=-1).astype(np.float64))
        self._rays = np.ascontiguousarray(rays.reshape(height + 2, width + 2, 2))
        rng = np.random.default_rng([seed, 0xB0A2D])
        self._light = _light(size, optics.lighting)
        self._backdrop = _backdrop(size, self._light, rng)
        noise = rng.standard_normal((height + _NOISE_SPARE[1], width + _NOISE_SPARE[0]), dtype=np.float32)
        self._noise = noise * np.float32(optics.noise_grey)
        self._offsets = _sample_offsets()

    def render(self, opened: Rigid, middle: Rigid, closed: Rigid, index: int) -> Image:
        """Render (height, width) uint8 of the board's frame in the camera's at the exposure's start, middle and end."""
        height, width = self._light.shape
        picture = self._backdrop.copy()
        box = self._extent((opened, middle, closed), width, height)
        if box is not None:
            x0, y0, x1, y1 = box
            size = ((x1 - x0) * _FINE, (y1 - y0) * _FINE)
            coarse = picture[y0:y1, x0:x1]
            fine = np.asarray(cv2.resize(coarse, size, interpolation=cv2.INTER_NEAREST), dtype=np.float32)
            _draw(
                fine,
                self._light[y0:y1, x0:x1],
                self._rays[y0 : y1 + 2, x0 : x1 + 2],
                self._to_squares(middle),
                self._to_squares(closed) - self._to_squares(opened),
                self._offsets,
                self._board.squares_x,
                self._board.squares_y,
            )
            if self._optics.blur_px > 0:
                cv2.GaussianBlur(fine, (0, 0), self._optics.blur_px * _FINE, dst=fine)
            picture[y0:y1, x0:x1] = cv2.resize(fine, (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA)
        dx, dy = np.random.default_rng([self._seed, index]).integers(0, _NOISE_SPARE)
        noise = self._noise[dy : dy + height, dx : dx + width]
        return np.asarray(cv2.add(picture, noise, dtype=cv2.CV_8U), dtype=np.uint8)

    def _to_squares(self, pose: Rigid) -> Floats:
        """Homography (3, 3) from rays to squares across and down from the print's top left corner, last entry 1."""
        board = self._board
        # A point at (a, d) squares lies at x = (a - nx/2) s, y = (ny/2 - d) s on the board.
        squares = np.array(
            [
                [board.square_m, 0.0, -board.squares_x / 2 * board.square_m],
                [0.0, -board.square_m, board.squares_y / 2 * board.square_m],
                [0.0, 0.0, 1.0],
            ]
        )
        plane = np.column_stack([pose.rotation[:, 0], pose.rotation[:, 1], pose.translation_m])
        inverse = np.linalg.inv(plane @ squares)
        return np.asarray(inverse / inverse[2, 2])

    def _extent(self, poses: tuple[Rigid, ...], width: int, height: int) -> tuple[int, int, int, int] | None:
        """Pixels that the board with its margin may touch; None when it is out of the picture or behind."""
        q = QUIET_SQUARES
        nx, ny = self._board.squares_x, self._board.squares_y
        rim = np.linspace(0, 1, 5)
        across = np.concatenate([-q + rim * (nx + 2 * q)] * 2 + [np.full(5, -q), np.full(5, nx + q)])
        down = np.concatenate([np.full(5, -q), np.full(5, ny + q)] + [-q + rim * (ny + 2 * q)] * 2)
        outline = self._board.at(across, down)
        seen = []
        for pose in poses:
            if pose.apply(outline)[:, 2].min() <= 0.01:
                return None
            vector, _ = cv2.Rodrigues(pose.rotation)
            seen.append(self._lens.project(outline, np.asarray(vector, dtype=np.float64), pose.translation_m))
        pixels = np.concatenate(seen)
        margin = 4 + int(np.ceil(4 * self._optics.blur_px))
        low = np.maximum(np.floor(pixels.min(axis=0)) - margin, 0)
        high = np.minimum(np.ceil(pixels.max(axis=0)) + margin, (width, height))
        if np.any(high - low < 2):
            return None
        return int(low[0]), int(low[1]), int(high[0]), int(high[1])


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
    """Sample positions (k, 3) in a pixel and in the exposure, each in -1/2..1/2, in opposite pairs.

    Pairs make every odd moment vanish, so that corners stay where they are.
    """
    # Generalised golden ratio in three dimensions: evenly spread for any number of points.
    g = 1.2207440846057596
    k = np.arange(1, _SAMPLES // 2 + 1)[:, None]
    half = (0.5 + k * np.array([1 / g, 1 / g**2, 1 / g**3])) % 1.0 - 0.5
    return np.concatenate([half, -half]).astype(np.float32)


@exact_kernel
def _share_beyond(distance: float, a: float, b: float, c: float) -> float:
    """Share of a pixel and an exposure that lies beyond an edge: P(distance + a X + b Y + c T > 0).

    X, Y, T are uniform over -1/2..1/2, so this is the distribution of a sum of three uniform variables.
    """
    a, b, c = max(abs(a), _LEAST_SLOPE), max(abs(b), _LEAST_SLOPE), max(abs(c), _LEAST_SLOPE)
    total = 0.0
    for i in range(8):
        p, q, r = (i & 1) * 2 - 1, (i & 2) - 1, (i & 4) // 2 - 1
        x = distance + 0.5 * (p * a + q * b + r * c)
        if x > 0:
            total += p * q * r * x * x * x
    return min(max(total / (6.0 * a * b * c), 0.0), 1.0)


@fast_kernel
def _albedo(u: float, v: float, nx: int, ny: int, backdrop: float) -> float:
    """Reflectance at (u, v) squares from the print's top left corner; `backdrop` beyond the white margin."""
    if u < -QUIET_SQUARES or v < -QUIET_SQUARES or u > nx + QUIET_SQUARES or v > ny + QUIET_SQUARES:
        return backdrop
    if u < 0 or v < 0 or u > nx or v > ny:
        return WHITE
    return WHITE if (int(u) + int(v)) & 1 else DARK


@fast_kernel
def _cell(
    u: float,
    v: float,
    by_u: tuple[float, float, float],
    by_v: tuple[float, float, float],
    offsets: Singles,
    nx: int,
    ny: int,
    backdrop: float,
) -> float:
    """Mean reflectance of a cell about (u, v) whose squares change by `by_u`, `by_v` across, down and in time."""
    ux, uy, ut = by_u
    vx, vy, vt = by_v
    u_line, v_line = round(u), round(v)
    on_u = 2 * abs(u - u_line) <= abs(ux) + abs(uy) + abs(ut)
    on_v = 2 * abs(v - v_line) <= abs(vx) + abs(vy) + abs(vt)
    if on_u and on_v:
        total = 0.0
        for k in range(offsets.shape[0]):
            dx, dy, t = offsets[k]
            total += _albedo(u + ux * dx + uy * dy + ut * t, v + vx * dx + vy * dy + vt * t, nx, ny, backdrop)
        return float(total / offsets.shape[0])
    if on_u:
        share = _share_beyond(u - u_line, ux, uy, ut)
        beyond, before = _albedo(u_line + 0.5, v, nx, ny, backdrop), _albedo(u_line - 0.5, v, nx, ny, backdrop)
        return float(share * beyond + (1 - share) * before)
    if on_v:
        share = _share_beyond(v - v_line, vx, vy, vt)
        beyond, before = _albedo(u, v_line + 0.5, nx, ny, backdrop), _albedo(u, v_line - 0.5, nx, ny, backdrop)
        return float(share * beyond + (1 - share) * before)
    return float(_albedo(u, v, nx, ny, backdrop))


@fast_kernel
def _draw(
    fine: Singles, light: Singles, rays: Floats, H: Floats, dH: Floats, offsets: Singles, nx: int, ny: int
) -> None:
    """Paint the board over `fine` (_FINE h, _FINE w); `rays` (h + 2, w + 2, 2) has a rim of one pixel.

    `H` maps a ray to squares at mid-exposure, `dH` is its change over the exposure. Within a pixel the map is taken
    as linear in position and time.
    """
    h, w = light.shape
    for i in range(h):
        for j in range(w):
            x = rays[i + 1, j + 1, 0]
            y = rays[i + 1, j + 1, 1]
            d = 1.0 / (H[2, 0] * x + H[2, 1] * y + H[2, 2])
            u = (H[0, 0] * x + H[0, 1] * y + H[0, 2]) * d
            v = (H[1, 0] * x + H[1, 1] * y + H[1, 2]) * d
            far = QUIET_SQUARES + 1
            if u < -far or v < -far or u > nx + far or v > ny + far:
                continue
            # The change of the map with time, at this ray, and with the pixel.
            dd = dH[2, 0] * x + dH[2, 1] * y + dH[2, 2]
            ut = (dH[0, 0] * x + dH[0, 1] * y + dH[0, 2] - u * dd) * d
            vt = (dH[1, 0] * x + dH[1, 1] * y + dH[1, 2] - v * dd) * d
            x_right = 0.5 * (rays[i + 1, j + 2, 0] - rays[i + 1, j, 0])
            y_right = 0.5 * (rays[i + 1, j + 2, 1] - rays[i + 1, j, 1])
            x_below = 0.5 * (rays[i + 2, j + 1, 0] - rays[i, j + 1, 0])
            y_below = 0.5 * (rays[i + 2, j + 1, 1] - rays[i, j + 1, 1])
            ua = (H[0, 0] - u * H[2, 0]) * d
            ub = (H[0, 1] - u * H[2, 1]) * d
            va = (H[1, 0] - v * H[2, 0]) * d
            vb = (H[1, 1] - v * H[2, 1]) * d
            ux = ua * x_right + ub * y_right
            uy = ua * x_below + ub * y_below
            vx = va * x_right + vb * y_right
            vy = va * x_below + vb * y_below
            backdrop = fine[i * _FINE, j * _FINE] / light[i, j]
            near_u = 2 * abs(u - round(u)) <= abs(ux) + abs(uy) + abs(ut)
            near_v = 2 * abs(v - round(v)) <= abs(vx) + abs(vy) + abs(vt)
            if not (near_u or near_v):
                grey = light[i, j] * _albedo(u, v, nx, ny, backdrop)
                for p in range(_FINE):
                    for q in range(_FINE):
                        fine[i * _FINE + p, j * _FINE + q] = grey
                continue
            by_u = (ux / _FINE, uy / _FINE, ut)
            by_v = (vx / _FINE, vy / _FINE, vt)
            for p in range(_FINE):
                for q in range(_FINE):
                    dx, dy = (q + 0.5) / _FINE - 0.5, (p + 0.5) / _FINE - 0.5
                    value = _cell(u + ux * dx + uy * dy, v + vx * dx + vy * dy, by_u, by_v, offsets, nx, ny, backdrop)
                    fine[i * _FINE + p, j * _FINE + q] = light[i, j] * value
