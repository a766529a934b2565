"""Drawing the checkerboard: the compiled kernels that turn a homography into grey values."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import calibration.vision.board
from calibration.vision.board import QUIET_SQUARES
from model.arrays import Array
from model.kernels.jit import kernel

Singles = NDArray[np.float32]

FINE = 2
"""The board is drawn on a grid so much finer: a blur of less than a pixel is no blur on the pixels' own grid."""

WHITE, DARK = 0.92, 0.10
_LEAST_SLOPE = 1e-4
_MARGIN = QUIET_SQUARES
_FAR = QUIET_SQUARES + 1
_CORNERS = tuple((0.5 * p, 0.5 * q, 0.5 * r, p * q * r) for p in (-1, 1) for q in (-1, 1) for r in (-1, 1))
# What is known of a cell: where its middle lies on the board, and by how much that changes across it and in time.
U, UX, UY, UT, V, VX, VY, VT, BEHIND = range(9)

_sources = (__file__, calibration.vision.board.__file__)
exact_kernel = partial(kernel, sources=_sources, fastmath=False)
fast_kernel = partial(kernel, sources=_sources, fastmath=True)


class ExposedView(NamedTuple):
    """What a camera sees of a board during one exposure.

    corner: the pixel (x, y) of the picture at the top left of what is drawn. light and backdrop (height, width): those
    of the whole picture. rays (2, height + 2, width + 2): with a rim of one pixel. H: map from a ray to squares at
    mid-exposure; dH: its change over the exposure. samples (3, k): where a pixel and an exposure are sampled.
    """

    corner: tuple[int, int]
    light: Singles
    backdrop: Singles
    rays: Array
    H: Array
    dH: Array  # noqa: N815 - the change of H
    samples: Singles


@fast_kernel
def share_beyond(distance: float, a: float, b: float, c: float) -> float:
    """Share of a cell and an exposure that lies beyond an edge: P(distance + a X + b Y + c T > 0).

    X, Y, T are uniform over -1/2..1/2, so this is the distribution of a sum of three uniform variables: a sum of
    truncated cubes over the corners of the cell.
    """
    a, b, c = max(abs(a), _LEAST_SLOPE), max(abs(b), _LEAST_SLOPE), max(abs(c), _LEAST_SLOPE)
    total = 0.0
    for p, q, r, sign in _CORNERS:
        x = max(distance + p * a + q * b + r * c, 0.0)
        total += sign * (x * x * x)
    return min(max(total / (6.0 * a * b * c), 0.0), 1.0)


@fast_kernel
def _albedo(u: float, v: float, nx: int, ny: int, backdrop: float) -> float:
    """Reflectance at (u, v) squares from the print's top left corner; `backdrop` beyond the white margin."""
    odd = np.floor(u) + np.floor(v)
    odd -= 2.0 * np.floor(0.5 * odd)
    on_print = (u >= 0.0) & (v >= 0.0) & (u <= nx) & (v <= ny)
    on_board = (u >= -_MARGIN) & (v >= -_MARGIN) & (u <= nx + _MARGIN) & (v <= ny + _MARGIN)
    square = DARK if on_print & (odd < 0.5) else WHITE
    return square if on_board else backdrop


@fast_kernel
def quarters(
    u: float, v: float, cells: Array, k: int, samples: Singles, surface: tuple[float, float, float, float]
) -> float:
    """Mean of a cell about (u, v) off the crossing of two lines.

    `surface`: what lies before both, beyond the first, beyond the second and beyond both of them.
    """
    u0, ux, uy, ut = np.float32(u), np.float32(cells[UX, k]), np.float32(cells[UY, k]), np.float32(cells[UT, k])
    v0, vx, vy, vt = np.float32(v), np.float32(cells[VX, k]), np.float32(cells[VY, k]), np.float32(cells[VT, k])
    n = samples.shape[1]
    first = second = both = np.float32(0)
    for i in range(n):
        dx, dy, t = samples[0, i], samples[1, i], samples[2, i]
        beyond_u = np.float32(u0 + ux * dx + uy * dy + ut * t > 0)
        beyond_v = np.float32(v0 + vx * dx + vy * dy + vt * t > 0)
        first += beyond_u
        second += beyond_v
        both += beyond_u * beyond_v
    neither = n - first - second + both
    total = neither * surface[0] + (first - both) * surface[1] + (second - both) * surface[2] + both * surface[3]
    return float(total / n)


@fast_kernel
def _crossing(cells: Array, k: int, samples: Singles, nx: int, ny: int) -> float:
    """Mean reflectance of a cell that touches lines of both kinds."""
    u, ux, uy, ut = cells[U, k], cells[UX, k], cells[UY, k], cells[UT, k]
    v, vx, vy, vt = cells[V, k], cells[VX, k], cells[VY, k], cells[VT, k]
    behind = cells[BEHIND, k]
    if abs(ux) + abs(uy) + abs(ut) > 1.0 or abs(vx) + abs(vy) + abs(vt) > 1.0:
        total = 0.0
        for i in range(samples.shape[1]):
            dx, dy, t = samples[0, i], samples[1, i], samples[2, i]
            total += _albedo(u + ux * dx + uy * dy + ut * t, v + vx * dx + vy * dy + vt * t, nx, ny, behind)
        return float(total / samples.shape[1])
    u_line, v_line = np.rint(u), np.rint(v)
    surface = (
        _albedo(u_line - 0.5, v_line - 0.5, nx, ny, behind),
        _albedo(u_line + 0.5, v_line - 0.5, nx, ny, behind),
        _albedo(u_line - 0.5, v_line + 0.5, nx, ny, behind),
        _albedo(u_line + 0.5, v_line + 0.5, nx, ny, behind),
    )
    return float(quarters(u - u_line, v - v_line, cells, k, samples, surface))


@fast_kernel
def _shade(cells: Array, n: int, samples: Singles, nx: int, ny: int, value: Array, crossed: Any) -> None:
    """Mean reflectances `value` (n,) of cells: rows `U` and so on of `cells`; `crossed` (n,) is room for notes."""
    u, ux, uy, ut = cells[U, :n], cells[UX, :n], cells[UY, :n], cells[UT, :n]
    v, vx, vy, vt = cells[V, :n], cells[VX, :n], cells[VY, :n], cells[VT, :n]
    behind = cells[BEHIND, :n]
    # Without a branch, for the vector registers: most cells lie at one line, and those at none cost no more.
    for k in range(n):
        wide, high = abs(ux[k]) + abs(uy[k]) + abs(ut[k]), abs(vx[k]) + abs(vy[k]) + abs(vt[k])
        u_line, v_line = np.rint(u[k]), np.rint(v[k])
        off_u, off_v = u[k] - u_line, v[k] - v_line
        on_u, on_v = 2 * abs(off_u) <= wide, 2 * abs(off_v) <= high
        crossed[k] = on_u & on_v
        share = share_beyond(
            off_u if on_u else off_v, ux[k] if on_u else vx[k], uy[k] if on_u else vy[k], ut[k] if on_u else vt[k]
        )
        u_side, v_side = 0.5 if on_u else 0.0, 0.5 if on_v else 0.0
        u_at, v_at = u_line if on_u else u[k], v_line if on_v else v[k]
        before = _albedo(u_at - u_side, v_at - v_side, nx, ny, behind[k])
        beyond = _albedo(u_at + u_side, v_at + v_side, nx, ny, behind[k])
        value[k] = before + (beyond - before) * share
    for k in range(n):
        if crossed[k]:
            value[k] = _crossing(cells, k, samples, nx, ny)


@fast_kernel
def board_coordinates(
    rays: Array,
    row: int,
    x0: int,
    H: Array,
    dH: Array,
    u: Array,
    ux: Array,
    uy: Array,
    ut: Array,
    v: Array,
    vx: Array,
    vy: Array,
    vt: Array,
) -> None:
    """Where the pixels of a row from `x0` look on the board, and by how much that changes with pixel and time."""
    w = len(u)
    h00, h01, h02, h10, h11, h12 = H[0, 0], H[0, 1], H[0, 2], H[1, 0], H[1, 1], H[1, 2]
    h20, h21, h22 = H[2, 0], H[2, 1], H[2, 2]
    d00, d01, d02, d10, d11, d12 = dH[0, 0], dH[0, 1], dH[0, 2], dH[1, 0], dH[1, 1], dH[1, 2]
    d20, d21, d22 = dH[2, 0], dH[2, 1], dH[2, 2]
    # Straight through and along views, without a branch: this loop runs in the processor's vector registers.
    here, left, right = slice(x0 + 1, x0 + 1 + w), slice(x0, x0 + w), slice(x0 + 2, x0 + 2 + w)
    x_here, x_left, x_right = rays[0, row, here], rays[0, row, left], rays[0, row, right]
    y_here, y_left, y_right = rays[1, row, here], rays[1, row, left], rays[1, row, right]
    x_above, x_below = rays[0, row - 1, here], rays[0, row + 1, here]
    y_above, y_below = rays[1, row - 1, here], rays[1, row + 1, here]
    for j in range(w):
        x, y = x_here[j], y_here[j]
        d = 1.0 / (h20 * x + h21 * y + h22)
        uj, vj = (h00 * x + h01 * y + h02) * d, (h10 * x + h11 * y + h12) * d
        # The change of the map with time, at this ray, and with the pixel.
        dd = d20 * x + d21 * y + d22
        xa, ya = 0.5 * (x_right[j] - x_left[j]), 0.5 * (y_right[j] - y_left[j])
        xd, yd = 0.5 * (x_below[j] - x_above[j]), 0.5 * (y_below[j] - y_above[j])
        ua, ub = (h00 - uj * h20) * d, (h01 - uj * h21) * d
        va, vb = (h10 - vj * h20) * d, (h11 - vj * h21) * d
        u[j], v[j] = uj, vj
        ut[j], vt[j] = (d00 * x + d01 * y + d02 - uj * dd) * d, (d10 * x + d11 * y + d12 - vj * dd) * d
        ux[j], uy[j] = ua * xa + ub * ya, ua * xd + ub * yd
        vx[j], vy[j] = va * xa + vb * ya, va * xd + vb * yd


@fast_kernel
def draw(fine: Singles, view: ExposedView, nx: int, ny: int) -> None:
    """Fill `fine` (FINE h, FINE w) with grey values of a checkerboard of nx by ny squares.

    Within a pixel the map is taken as linear in position and time.
    """
    corner, light, backdrop, rays, H, dH, samples = view
    x0, y0 = corner
    h, w = fine.shape[0] // FINE, fine.shape[1] // FINE
    u, ux, uy, ut = np.empty(w), np.empty(w), np.empty(w), np.empty(w)
    v, vx, vy, vt = np.empty(w), np.empty(w), np.empty(w), np.empty(w)
    plain, grey = np.empty(w, np.bool_), np.empty(w, np.float32)
    room = FINE * FINE * w
    cells, value, crossed = np.empty((BEHIND + 1, room)), np.empty(room), np.empty(room, np.bool_)
    for i in range(h):
        board_coordinates(rays, y0 + i + 1, x0, H, dH, u, ux, uy, ut, v, vx, vy, vt)
        for j in range(w):
            off_u = 2 * abs(u[j] - np.rint(u[j])) > abs(ux[j]) + abs(uy[j]) + abs(ut[j])
            off_v = 2 * abs(v[j] - np.rint(v[j])) > abs(vx[j]) + abs(vy[j]) + abs(vt[j])
            far = (u[j] < -_FAR) | (v[j] < -_FAR) | (u[j] > nx + _FAR) | (v[j] > ny + _FAR)
            plain[j] = far | (off_u & off_v)
        bright, behind = light[y0 + i, x0 : x0 + w], backdrop[y0 + i, x0 : x0 + w]
        for j in range(w):
            grey[j] = bright[j] * _albedo(u[j], v[j], nx, ny, behind[j] / bright[j])
        for p in range(FINE):
            line = fine[i * FINE + p]
            for j in range(w):
                for q in range(FINE):
                    line[j * FINE + q] = grey[j]
        n = 0
        for j in range(w):
            if not plain[j]:
                for p in range(FINE):
                    for q in range(FINE):
                        dx, dy = (q + 0.5) / FINE - 0.5, (p + 0.5) / FINE - 0.5
                        cells[U, n], cells[V, n] = u[j] + ux[j] * dx + uy[j] * dy, v[j] + vx[j] * dx + vy[j] * dy
                        cells[UX, n], cells[UY, n], cells[UT, n] = ux[j] / FINE, uy[j] / FINE, ut[j]
                        cells[VX, n], cells[VY, n], cells[VT, n] = vx[j] / FINE, vy[j] / FINE, vt[j]
                        cells[BEHIND, n] = behind[j] / bright[j]
                        n += 1
        _shade(cells, n, samples, nx, ny, value, crossed)
        n = 0
        for j in range(w):
            if not plain[j]:
                for p in range(FINE):
                    for q in range(FINE):
                        fine[i * FINE + p, j * FINE + q] = bright[j] * value[n]
                        n += 1


@fast_kernel
def shrink(fine: Singles, taps: Singles, out: Singles) -> None:
    """Blur `fine` (FINE h, FINE w) and take the mean over each pixel of `out` (h, w), both in one pass.

    `taps` (even number of them) are the weights about a pixel's middle; beyond the rim the rim is repeated.
    """
    h, w = out.shape
    reach = len(taps) // 2 - 1
    side = reach // FINE + 1
    down = np.empty(FINE * w, np.float32)
    even, odd = np.empty(w + 2 * side, np.float32), np.empty(w + 2 * side, np.float32)
    for i in range(h):
        down[:] = 0
        for k in range(len(taps)):
            tap, row = taps[k], fine[min(max(FINE * i + k - reach, 0), FINE * h - 1)]
            for j in range(FINE * w):
                down[j] += tap * row[j]
        for j in range(w):
            even[side + j], odd[side + j] = down[2 * j], down[2 * j + 1]
        even[:side] = odd[:side] = down[0]
        even[side + w :] = odd[side + w :] = down[FINE * w - 1]
        line = out[i]
        line[:] = 0
        for k in range(len(taps)):
            tap, shift = taps[k], side + (k - reach) // FINE
            half = (even if (k - reach) % FINE == 0 else odd)[shift : shift + w]
            for j in range(w):
                line[j] += tap * half[j]
