"""What the tip of a rig can reach at rest, within the limits of its pressures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from contourpy import LineType, contour_generator
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from model.arrays import Array
from model.inverse.reachable import reachable_tips
from rig.config.arm_model import model_arm
from rig.config.schema import RigConfig, checked_config
from rig.config.sections import Variant
from rig.tip_planning.path_follower import drive_of
from runs.report import drawing
from runs.report.colours import INK, MEASURED, RUNS

LEVELS = {1: 400, 2: 60, 3: 16}
"""Pressures of each valve, by the number of valves."""
MOST_VALVES_LEVELS = 5
SECTIONS = 5
RADII, ANGLES = 48, 36
"""Points of a section that are tested."""
CUBE = ((0, 1, 3, 7), (0, 1, 5, 7), (0, 2, 3, 7), (0, 2, 6, 7), (0, 4, 5, 7), (0, 4, 6, 7))
"""Corners of the tetrahedra of a cube of pressures (Kuhn), corner k = 4 i + 2 j + l."""
EDGE = -1e-9
FINE = 8
"""Points of an outline for each level of a pressure."""


@dataclass(frozen=True, eq=False)
class WorkspaceSection:
    """What is reached at a height [mm]: at radii (R,) [mm] and angles (A,) [rad] about the axis, reached (R, A).

    The outline is in lines (n, 2) of x and y [mm], whose ends meet.
    """

    height_mm: float
    radii_mm: Array
    angles_rad: Array
    reached: NDArray[np.bool_]
    outline_mm: tuple[Array, ...]

    @property
    def farthest_mm(self) -> float:
        """Largest radius that is reached at some angle."""
        return float(self.radii_mm[self.reached.any(axis=1)].max(initial=0.0))

    @property
    def circles_mm(self) -> tuple[float, float] | None:
        """Smallest and largest circle about the axis that is reached at every angle; None without any."""
        whole = self.radii_mm[self.reached.all(axis=1)]
        return (float(whole.min()), float(whole.max())) if len(whole) else None


@dataclass(frozen=True, eq=False)
class TipWorkspace:
    """Tips (n, 3) [mm] on a grid of the pressures, and horizontal sections of a volume; none of a surface or a line."""

    tip_mm: Array
    sections: tuple[WorkspaceSection, ...]

    @property
    def height_mm(self) -> tuple[float, float]:
        """Lowest and highest z."""
        return float(self.tip_mm[:, 2].min()), float(self.tip_mm[:, 2].max())

    @property
    def radius_mm(self) -> float:
        """Largest distance from the axis."""
        return float(np.linalg.norm(self.tip_mm[:, :2], axis=1).max())


def workspace(config: RigConfig, variant: Variant | None = None) -> TipWorkspace:
    """Sample what the rig's arm reaches at rest.

    Raises:
        ArithmeticError: the arm has no stable equilibrium within its limits.
        BadInputError: it is no configuration.
    """
    drive = drive_of(checked_config("workspace", config))
    levels = LEVELS.get(drive.valves, MOST_VALVES_LEVELS)
    _, tips = reachable_tips(model_arm(config, variant), drive, levels)
    tips = 1e3 * tips
    finite = tips[np.isfinite(tips).all(axis=1)]
    if not len(finite):
        raise ArithmeticError(f"the arm of rig {config.name} has no stable equilibrium within its limits")
    return TipWorkspace(finite, _sections(tips, levels) if drive.valves == 3 else ())


def _sections(tips: Array, levels: int) -> tuple[WorkspaceSection, ...]:
    """Sections of the image of the cube of three pressures, whose cells are mapped as tetrahedra."""
    grid = tips.reshape(levels, levels, levels, 3)
    corners = np.array(
        [
            grid[i : levels - 1 + i, j : levels - 1 + j, k : levels - 1 + k].reshape(-1, 3)
            for i in (0, 1)
            for j in (0, 1)
            for k in (0, 1)
        ]
    )
    cells = np.concatenate([corners[list(four)].transpose(1, 0, 2) for four in CUBE])
    cells = cells[np.isfinite(cells).all(axis=(1, 2))]
    heights = cells[:, :, 2]
    low, high = float(heights.min()), float(heights.max())
    radii = np.linspace(0.0, float(np.linalg.norm(cells[:, :, :2], axis=2).max()), RADII)
    angles: Array = 2 * np.pi * np.arange(0.0, ANGLES) / ANGLES
    plane = np.stack([np.outer(radii, np.cos(angles)), np.outer(radii, np.sin(angles))], axis=-1).reshape(-1, 2)
    faces = [_refined(np.take(grid, end, axis)) for axis in range(3) for end in (0, -1)]
    found = []
    for height in np.linspace(low, high, SECTIONS + 2)[1:-1].tolist():
        crossing = cells[(heights.min(axis=1) <= height) & (heights.max(axis=1) >= height)]
        points = np.column_stack([plane, np.full(len(plane), height)])
        reached = _inside(crossing, points).reshape(RADII, ANGLES)
        outline = tuple(line for face in faces for line in _level_lines(face, height))
        found.append(WorkspaceSection(height, radii, angles, reached, outline))
    return tuple(found)


def _refined(face: Array) -> Array:
    """Return tips of a face of the cube of pressures at more levels, by cubic splines: (n, n, 3) as (m, m, 3)."""
    if not np.isfinite(face).all():
        return face
    levels = np.arange(len(face))
    between = np.linspace(0, len(face) - 1, FINE * (len(face) - 1) + 1)
    for axis in (0, 1):
        face = make_interp_spline(levels, face, axis=axis)(between)
    return face


def _level_lines(face: Array, height_mm: float) -> list[Array]:
    """Return lines (n, 2) of x and y [mm] along which the tips (m, m, 3) of a face are at a height.

    The pressures map the surface of their cube to the surface of what is reached, as long as no two give the same tip.
    """
    x_mm, y_mm, z_mm = np.moveaxis(face, 2, 0)
    drawn = contour_generator(x_mm, y_mm, np.ma.masked_invalid(z_mm), line_type=LineType.Separate)
    return [np.asarray(line) for line in drawn.lines(height_mm)]


def _inside(cells: Array, points: Array) -> NDArray[np.bool_]:
    """Which points (p, 3) lie in a tetrahedron (c, 4, 3): all barycentric coordinates are positive."""
    edges = (cells[:, 1:] - cells[:, :1]).transpose(0, 2, 1)
    solid = np.abs(np.linalg.det(edges)) > 1e-12
    inverse, origin = np.linalg.inv(edges[solid]), cells[solid, 0]
    found = np.zeros(len(points), dtype=np.bool_)
    for k, point in enumerate(points):
        shares = np.einsum("cij,cj->ci", inverse, point - origin)
        found[k] = bool(np.any((shares.min(axis=1) >= EDGE) & (shares.sum(axis=1) <= 1 - EDGE)))
    return found


def draw(figure: Figure, space: TipWorkspace) -> None:
    """The tips from the side, and the sections, or the tips, from above."""
    beside, above = drawing.panels(figure, columns=2)[0]
    beside.plot(space.tip_mm[:, 0], space.tip_mm[:, 2], ".", ms=1.2, color=MEASURED, alpha=0.5)
    beside.set_ylabel("z, along the arm [mm]")
    beside.invert_yaxis()
    if not space.sections:
        above.plot(space.tip_mm[:, 0], space.tip_mm[:, 1], ".", ms=1.2, color=MEASURED)
    for section, colour in zip(space.sections, RUNS, strict=False):
        for line in section.outline_mm:
            above.plot(*line.T, color=colour, lw=1.1)
        above.plot([], [], color=colour, lw=1.1, label=f"z {section.height_mm:.0f}")
        beside.axhline(section.height_mm, color=colour, lw=0.7)
    above.plot(0, 0, "+", color=INK)
    above.set_ylabel("y [mm]")
    for axes in (beside, above):
        axes.set_xlabel("x [mm]")
        axes.set_aspect("equal", adjustable="datalim")
    drawing.legend(above, columns=10)
