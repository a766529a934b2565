"""Drawing any print of dark and white cells: the compiled kernel, and which kernel draws which kind of board."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial, singledispatch

import numpy as np
from numpy.typing import NDArray

import rig.simulator.checkerboard_rendering
from calibration.vision.board import Board
from calibration.vision.checkerboard import Checkerboard
from model.arrays import Array
from model.kernels.jit import kernel
from rig.simulator.checkerboard_rendering import (
    BEHIND,
    DARK,
    FINE,
    UT,
    UX,
    UY,
    VT,
    VX,
    VY,
    WHITE,
    ExposedView,
    board_coordinates,
    draw,
    quarters,
    share_beyond,
)

Singles = NDArray[np.float32]

_BACKDROP = -1.0
"""Marks what lies beyond the board's margin in a table of reflectances."""
# What is known of a cell of the fine grid at one edge: its distance, by how much that changes across the cell and in
# time, the light, and the reflectances on both sides.
_DISTANCE, _SLOPE_X, _SLOPE_Y, _SLOPE_T, _BRIGHT, _BEFORE, _BEYOND = range(7)

fast_kernel = partial(kernel, sources=(__file__, rig.simulator.checkerboard_rendering.__file__), fastmath=True)


BoardRenderer = Callable[[Singles, ExposedView], None]
"""Fills the fine grid (FINE h, FINE w) with grey values."""


@singledispatch
def renderer(board: Board) -> BoardRenderer:
    """What draws a board: the kernel for any print, unless its class has one of its own."""
    return table_renderer(*print_table(board))


@renderer.register
def _(board: Checkerboard) -> BoardRenderer:
    return partial(draw, nx=board.squares_x, ny=board.squares_y)


def print_table(board: Board) -> tuple[Array, Array, Array]:
    """Lines across (p,) and down (q,) in units of the board, also of its margin, and what is between them.

    That is a table (q + 1, p + 1) of reflectances, with the backdrop at its rim.
    """
    printed = board.printed
    (width, height), margin = board.extent, printed.margin
    across = np.concatenate([[-margin], printed.across, [width + margin]])
    down = np.concatenate([[-margin], printed.down, [height + margin]])
    table = np.full((len(down) + 1, len(across) + 1), _BACKDROP)
    table[1:-1, 1:-1] = WHITE
    table[2:-2, 2:-2] = np.where(printed.dark, DARK, WHITE)
    return across, down, table


def table_renderer(across: Array, down: Array, table: Array) -> BoardRenderer:
    """The kernel for any print, from a `print_table`."""
    return partial(draw_print, across=across, down=down, table=table)


@fast_kernel
def _cell(lines: Array, at: float, near: int) -> int:
    """How many lines (n,) lie at or before a place, found by steps from a guess."""
    while near < len(lines) and at >= lines[near]:
        near += 1
    while near > 0 and at < lines[near - 1]:
        near -= 1
    return near


@fast_kernel
def _nearest(lines: Array, at: float, cell: int) -> int:
    """The line nearest to a place, of those at either side of its cell."""
    if cell == 0:
        return 0
    if cell == len(lines):
        return cell - 1
    return cell if lines[cell] - at < at - lines[cell - 1] else cell - 1


@fast_kernel
def _surface(table: Array, row: int, column: int, backdrop: float) -> float:
    """Reflectance of a cell."""
    value = table[row, column]
    return value if value >= 0.0 else backdrop


@fast_kernel
def _uniform(table: Array, first_row: int, last_row: int, first_column: int, last_column: int) -> bool:
    """Whether all cells from one to another have the same reflectance."""
    value = table[first_row, first_column]
    for row in range(first_row, last_row + 1):
        for column in range(first_column, last_column + 1):
            if table[row, column] != value:
                return False
    return True


@fast_kernel
def draw_print(fine: Singles, view: ExposedView, across: Array, down: Array, table: Array) -> None:
    """Fill `fine` (FINE h, FINE w) with grey values of cells between lines.

    The lines and the table are those of `print_table`. Cells are taken to be larger than those of the fine grid.
    """
    corner, light, backdrop, rays, H, dH, samples = view
    x0, y0 = corner
    h, w = fine.shape[0] // FINE, fine.shape[1] // FINE
    u, ux, uy, ut = np.empty(w), np.empty(w), np.empty(w), np.empty(w)
    v, vx, vy, vt = np.empty(w), np.empty(w), np.empty(w), np.empty(w)
    one = np.empty((BEHIND + 1, 1))
    edges, value = np.empty((_BEYOND + 1, FINE * FINE * w)), np.empty(FINE * FINE * w)
    place = np.empty((2, FINE * FINE * w), np.int64)
    for i in range(h):
        board_coordinates(rays, y0 + i + 1, x0, H, dH, u, ux, uy, ut, v, vx, vy, vt)
        column = row = last_column = last_row = n = 0
        for j in range(w):
            bright = light[y0 + i, x0 + j]
            behind = backdrop[y0 + i, x0 + j] / bright
            wide, high = abs(ux[j]) + abs(uy[j]) + abs(ut[j]), abs(vx[j]) + abs(vy[j]) + abs(vt[j])
            column, row = _cell(across, u[j] - 0.5 * wide, column), _cell(down, v[j] - 0.5 * high, row)
            last_column = _cell(across, u[j] + 0.5 * wide, last_column)
            last_row = _cell(down, v[j] + 0.5 * high, last_row)
            if _uniform(table, row, last_row, column, last_column):
                grey = bright * _surface(table, row, column, behind)
                for p in range(FINE):
                    for q in range(FINE):
                        fine[i * FINE + p, j * FINE + q] = grey
                continue
            one[UX, 0], one[UY, 0], one[UT, 0] = ux[j] / FINE, uy[j] / FINE, ut[j]
            one[VX, 0], one[VY, 0], one[VT, 0] = vx[j] / FINE, vy[j] / FINE, vt[j]
            for p in range(FINE):
                for q in range(FINE):
                    dx, dy = (q + 0.5) / FINE - 0.5, (p + 0.5) / FINE - 0.5
                    at_u, at_v = u[j] + ux[j] * dx + uy[j] * dy, v[j] + vx[j] * dx + vy[j] * dy
                    place[0, n], place[1, n] = i * FINE + p, j * FINE + q
                    if _put_edge(at_u, at_v, one, samples, across, down, table, column, row, behind, edges, n):
                        fine[i * FINE + p, j * FINE + q] = bright * edges[_BEFORE, n]
                    else:
                        edges[_BRIGHT, n] = bright
                        n += 1
        _shade(edges, n, value)
        for k in range(n):
            fine[place[0, k], place[1, k]] = value[k]


@fast_kernel
def _shade(edges: Array, n: int, value: Array) -> None:
    """Grey values (n,) of cells at one edge each; without a branch, for the vector registers."""
    distance, a, b, c = edges[_DISTANCE], edges[_SLOPE_X], edges[_SLOPE_Y], edges[_SLOPE_T]
    before, beyond, bright = edges[_BEFORE], edges[_BEYOND], edges[_BRIGHT]
    for k in range(n):
        share = share_beyond(distance[k], a[k], b[k], c[k])
        value[k] = bright[k] * (before[k] + (beyond[k] - before[k]) * share)


@fast_kernel
def _put_edge(
    u: float,
    v: float,
    one: Array,
    samples: Singles,
    across: Array,
    down: Array,
    table: Array,
    column: int,
    row: int,
    behind: float,
    edges: Array,
    k: int,
) -> bool:
    """Put the edge at a cell of the fine grid about (u, v), of the extent `one` (9, 1), into column `k` of `edges`.

    True if two edges cross there, or if there is none: the mean reflectance is then in the row `_BEFORE`.
    """
    column, row = _cell(across, u, column), _cell(down, v, row)
    at_u, at_v = _nearest(across, u, column), _nearest(down, v, row)
    ux, uy, ut = one[UX, 0], one[UY, 0], one[UT, 0]
    vx, vy, vt = one[VX, 0], one[VY, 0], one[VT, 0]
    off_u, off_v = u - across[at_u], v - down[at_v]
    on_u = 2 * abs(off_u) <= abs(ux) + abs(uy) + abs(ut)
    on_v = 2 * abs(off_v) <= abs(vx) + abs(vy) + abs(vt)
    left, right = (at_u, at_u + 1) if on_u else (column, column)
    above, below = (at_v, at_v + 1) if on_v else (row, row)
    surface = (
        _surface(table, above, left, behind),
        _surface(table, above, right, behind),
        _surface(table, below, left, behind),
        _surface(table, below, right, behind),
    )
    # A line is an edge only where it parts dark from white.
    on_u = surface[0] != surface[1] or surface[2] != surface[3]
    on_v = surface[0] != surface[2] or surface[1] != surface[3]
    edges[_BEFORE, k], edges[_BEYOND, k] = surface[0], surface[3]
    if on_u and on_v:
        edges[_BEFORE, k] = quarters(off_u, off_v, one, 0, samples, surface)
        return True
    if on_u:
        edges[_DISTANCE, k], edges[_SLOPE_X, k], edges[_SLOPE_Y, k], edges[_SLOPE_T, k] = off_u, ux, uy, ut
    else:
        edges[_DISTANCE, k], edges[_SLOPE_X, k], edges[_SLOPE_Y, k], edges[_SLOPE_T, k] = off_v, vx, vy, vt
    return not (on_u or on_v)
