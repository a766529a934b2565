"""Drawing any print of dark and white cells: the compiled kernel, and which kernel draws which kind of board."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial, singledispatch
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

import rig.simulator.board_rendering
from calibration.vision.board import Board
from calibration.vision.checkerboard import Checkerboard
from model.kernels.jit import kernel
from rig.simulator.board_rendering import (
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
    draw,
    look_along,
    quarters,
    share_beyond,
)

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

_BACKDROP = -1.0
"""Marks what lies beyond the board's margin in a table of reflectances."""

fast_kernel = partial(kernel, sources=(__file__, rig.simulator.board_rendering.__file__), fastmath=True)


class Painter(Protocol):
    """Fills `fine` (FINE h, FINE w) with grey values; see `rig.simulator.board_rendering.draw`."""

    def __call__(
        self,
        fine: Singles,
        corner: tuple[int, int],
        light: Singles,
        backdrop: Singles,
        rays: Floats,
        H: Floats,
        dH: Floats,
        samples: Singles,
        /,
    ) -> None: ...


@singledispatch
def painter(board: Board) -> Painter:
    """What draws a board: the kernel for any print, unless its class has one of its own."""
    return print_painter(board)


@painter.register
def _(board: Checkerboard) -> Painter:
    def paint(*scene: object) -> None:
        draw(*scene, board.squares_x, board.squares_y)

    return paint


@dataclass(frozen=True)
class Cover:
    """A matt strip on the board, between `left`, `top`, `right` and `bottom` in shares of the print's extent."""

    left: float
    top: float
    right: float
    bottom: float
    reflectance: float = 0.35


def print_painter(board: Board, cover: Cover | None = None) -> Painter:
    """The kernel for any print, a part of which may be covered."""
    printed = board.printed
    (width, height), margin = board.extent, printed.margin
    across = np.concatenate([[-margin], printed.across, [width + margin]])
    down = np.concatenate([[-margin], printed.down, [height + margin]])
    table = np.full((len(down) + 1, len(across) + 1), _BACKDROP)
    table[1:-1, 1:-1] = WHITE
    table[2:-2, 2:-2] = np.where(printed.dark, DARK, WHITE)
    if cover is not None:
        across, table = _covered(across, table, cover.left * width, cover.right * width)
        down, rows = _covered(down, table.T, cover.top * height, cover.bottom * height)
        table = np.ascontiguousarray(rows.T)
        x, y = _middles(across), _middles(down)
        inside_x = (x > cover.left * width) & (x < cover.right * width)
        table[np.ix_((y > cover.top * height) & (y < cover.bottom * height), inside_x)] = cover.reflectance

    def paint(*scene: object) -> None:
        draw_print(*scene, across, down, table)

    return paint


def _covered(lines: Floats, columns: Floats, first: float, last: float) -> tuple[Floats, Floats]:
    """Lines and the columns of the table between them, with two more lines."""
    split = np.unique(np.concatenate([lines, [first, last]]))
    return split, columns[:, np.searchsorted(lines, np.concatenate([[-np.inf], split]), side="right")]


def _middles(lines: Floats) -> Floats:
    """A place in each of the cells that the lines part, also before the first and after the last."""
    return np.concatenate([[-np.inf], (lines[1:] + lines[:-1]) / 2, [np.inf]])


@fast_kernel
def _cell(lines: Floats, at: float, near: int) -> int:
    """How many lines (n,) lie at or before a place, found by steps from a guess."""
    while near < len(lines) and at >= lines[near]:
        near += 1
    while near > 0 and at < lines[near - 1]:
        near -= 1
    return near


@fast_kernel
def _nearest(lines: Floats, at: float, cell: int) -> int:
    """The line nearest to a place, of those at either side of its cell."""
    if cell == 0:
        return 0
    if cell == len(lines):
        return cell - 1
    return cell if lines[cell] - at < at - lines[cell - 1] else cell - 1


@fast_kernel
def _surface(table: Floats, row: int, column: int, backdrop: float) -> float:
    """Reflectance of a cell."""
    value = table[row, column]
    return value if value >= 0.0 else backdrop


@fast_kernel
def draw_print(
    fine: Singles,
    corner: tuple[int, int],
    light: Singles,
    backdrop: Singles,
    rays: Floats,
    H: Floats,
    dH: Floats,
    samples: Singles,
    across: Floats,
    down: Floats,
    table: Floats,
) -> None:
    """Fill `fine` as `rig.simulator.board_rendering.draw` does, for cells between lines.

    `across` (p,) and `down` (q,) are the lines in units of the board, `table` (q + 1, p + 1) the reflectances between
    them. Cells are taken to be larger than those of the fine grid.
    """
    x0, y0 = corner
    h, w = fine.shape[0] // FINE, fine.shape[1] // FINE
    u, ux, uy, ut = np.empty(w), np.empty(w), np.empty(w), np.empty(w)
    v, vx, vy, vt = np.empty(w), np.empty(w), np.empty(w), np.empty(w)
    one = np.empty((BEHIND + 1, 1))
    for i in range(h):
        look_along(rays, y0 + i + 1, x0, H, dH, u, ux, uy, ut, v, vx, vy, vt)
        column = row = 0
        for j in range(w):
            bright = light[y0 + i, x0 + j]
            behind = backdrop[y0 + i, x0 + j] / bright
            column, row = _cell(across, u[j], column), _cell(down, v[j], row)
            wide, high = abs(ux[j]) + abs(uy[j]) + abs(ut[j]), abs(vx[j]) + abs(vy[j]) + abs(vt[j])
            off_u = 2 * abs(u[j] - across[_nearest(across, u[j], column)]) > wide
            off_v = 2 * abs(v[j] - down[_nearest(down, v[j], row)]) > high
            if off_u and off_v:
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
                    value = _shade(
                        u[j] + ux[j] * dx + uy[j] * dy,
                        v[j] + vx[j] * dx + vy[j] * dy,
                        one,
                        samples,
                        across,
                        down,
                        table,
                        column,
                        row,
                        behind,
                    )
                    fine[i * FINE + p, j * FINE + q] = bright * value


@fast_kernel
def _shade(
    u: float,
    v: float,
    one: Floats,
    samples: Singles,
    across: Floats,
    down: Floats,
    table: Floats,
    column: int,
    row: int,
    behind: float,
) -> float:
    """Mean reflectance of a cell of the fine grid about (u, v), whose extent is in `one` (9, 1)."""
    column, row = _cell(across, u, column), _cell(down, v, row)
    at_u, at_v = _nearest(across, u, column), _nearest(down, v, row)
    ux, uy, ut = one[UX, 0], one[UY, 0], one[UT, 0]
    vx, vy, vt = one[VX, 0], one[VY, 0], one[VT, 0]
    off_u, off_v = u - across[at_u], v - down[at_v]
    on_u = 2 * abs(off_u) <= abs(ux) + abs(uy) + abs(ut)
    on_v = 2 * abs(off_v) <= abs(vx) + abs(vy) + abs(vt)
    if on_u and on_v:
        surface = (
            _surface(table, at_v, at_u, behind),
            _surface(table, at_v, at_u + 1, behind),
            _surface(table, at_v + 1, at_u, behind),
            _surface(table, at_v + 1, at_u + 1, behind),
        )
        return float(quarters(off_u, off_v, one, 0, samples, surface))
    if on_u:
        before, beyond = _surface(table, row, at_u, behind), _surface(table, row, at_u + 1, behind)
        return float(before + (beyond - before) * share_beyond(off_u, ux, uy, ut))
    if on_v:
        before, beyond = _surface(table, at_v, column, behind), _surface(table, at_v + 1, column, behind)
        return float(before + (beyond - before) * share_beyond(off_v, vx, vy, vt))
    return float(_surface(table, row, column, behind))
