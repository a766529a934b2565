"""The drawings of the documentation: `python -m scripts.drawings` writes them to `docs/figures`.

Lengths are in units of a drawing of about 10 by 5; the arm of `tube_to_tip` is a solution of the model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, FancyBboxPatch, Polygon, Rectangle

from model import Arm
from model.statics import statics
from model.units import PA_PER_BAR

PLACE = Path(__file__).parents[1] / "docs" / "figures"
STYLE = {"svg.fonttype": "none", "svg.hashsalt": "softrig", "font.family": "sans-serif", "font.size": 9}
AIR, SIGNAL, SOFT, METAL = "#1f77b4", "#333333", "#e8c9a0", "#d9dde1"
X, Y, Z = "#c0392b", "#2e8b57", "#2457a6"

Point = tuple[float, float]


def box(axes: Axes, place: Point, size: Point, text: str, colour: str = "#f4f6f8") -> None:
    """A block with its name in the middle; the place is that of its lower left corner."""
    axes.add_patch(FancyBboxPatch(place, *size, boxstyle="round,pad=0,rounding_size=0.08", fc=colour, ec=SIGNAL, lw=1))
    axes.text(place[0] + size[0] / 2, place[1] + size[1] / 2, text, ha="center", va="center")


def arrow(
    axes: Axes,
    points: Sequence[Point],
    text: str = "",
    *,
    colour: str = SIGNAL,
    offset: Point = (0.0, 0.13),
    dashed: bool = False,
) -> None:
    """A signal along points, with its name at the middle of the longest part."""
    line = "--" if dashed else "-"
    if len(points) > 2:
        axes.plot(*zip(*points[:-1], strict=True), color=colour, lw=1.2, ls=line, solid_joinstyle="miter")
    style = {
        "arrowstyle": "-|>",
        "mutation_scale": 10,
        "color": colour,
        "lw": 1.2,
        "ls": line,
        "shrinkA": 0,
        "shrinkB": 0,
    }
    axes.add_patch(FancyArrowPatch(points[-2], points[-1], **style))
    if text:
        parts = list(pairwise(points))
        start, end = max(parts, key=lambda part: float(np.hypot(part[1][0] - part[0][0], part[1][1] - part[0][1])))
        middle = (start[0] + end[0]) / 2 + offset[0], (start[1] + end[1]) / 2 + offset[1]
        axes.text(*middle, text, ha="center", va="bottom", color=colour, fontsize=8)


def frame(axes: Axes, origin: Point, directions: dict[str, Point], name: str, place: Point) -> None:
    """The axes of a frame as they are seen, and its name."""
    for axis, direction in directions.items():
        colour = {"x": X, "y": Y, "z": Z}[axis]
        end = origin[0] + direction[0], origin[1] + direction[1]
        axes.add_patch(
            FancyArrowPatch(origin, end, arrowstyle="-|>", mutation_scale=9, color=colour, lw=1.5, shrinkA=0)
        )
        axes.text(
            origin[0] + 1.25 * direction[0],
            origin[1] + 1.25 * direction[1],
            axis,
            color=colour,
            ha="center",
            va="center",
        )
    axes.text(origin[0] + place[0], origin[1] + place[1], name, fontsize=8, style="italic", ha="center", va="center")


def bench(axes: Axes) -> None:
    """The bench: air, electricity, camera and arm, with the frames of base, tip, board and camera."""
    axes.set(xlim=(-0.2, 11.4), ylim=(0.4, 6.4))
    box(axes, (0, 4.6), (1.9, 0.9), "computer\nrig run")
    box(axes, (0, 2.9), (1.9, 0.9), "card\noutputs, inputs")
    box(axes, (2.9, 2.9), (1.5, 0.9), "valves")
    box(axes, (2.9, 4.6), (1.5, 0.9), "sensors")
    box(axes, (2.9, 1.0), (1.5, 0.9), "supply, shut-off\nvalve by hand", METAL)
    arrow(axes, [(0.95, 4.6), (0.95, 3.8)])
    arrow(axes, [(1.9, 3.35), (2.9, 3.35)], "V")
    arrow(axes, [(2.9, 5.05), (2.4, 5.05), (2.4, 3.65), (1.9, 3.65)], "V", offset=(-0.18, 0.0))
    arrow(axes, [(3.65, 1.9), (3.65, 2.9)], colour=AIR)
    arrow(axes, [(3.65, 3.8), (3.65, 4.6)], colour=AIR)
    axes.plot([4.4, 5.2, 5.2, 6.6], [3.35, 3.35, 5.75, 5.75], color=AIR, lw=2)
    axes.text(5.32, 4.4, "air, P", color=AIR, fontsize=8)
    axes.add_patch(Rectangle((5.9, 5.5), 2.6, 0.25, fc=METAL, ec=SIGNAL))
    along = np.linspace(0, 1, 60)
    bent, down = 1.1 * along**2, 5.5 - 3.3 * along + 0.25 * along**2
    for aside in (-0.42, 0.0, 0.42):
        axes.plot(7.2 + aside + bent, down + 0.3 * aside * along, color=SOFT, lw=11, solid_capstyle="butt", zorder=0)
        axes.plot(7.2 + aside + bent, down + 0.3 * aside * along, color="#a9772f", lw=0.8)
    tip = np.array([8.3, 2.45])
    turned = np.array([[0.93, 0.37], [-0.37, 0.93]])
    cap = tip + np.array([[-0.75, -0.2], [0.75, -0.2], [0.75, 0.05], [-0.75, 0.05]]) @ turned
    axes.add_patch(Polygon(cap, fc=METAL, ec=SIGNAL))
    board = tip + np.array([[-0.5, -1.05], [0.5, -1.05], [0.5, -0.25], [-0.5, -0.25]]) @ turned
    axes.add_patch(Polygon(board, fc="white", ec=SIGNAL))
    for row in range(4):
        for column in range(5):
            if (row + column) % 2:
                corner = np.array([-0.5 + 0.2 * column, -1.05 + 0.2 * row])
                square = corner + np.array([[0, 0], [0.2, 0], [0.2, 0.2], [0, 0.2]])
                axes.add_patch(Polygon(tip + square @ turned, fc=SIGNAL, lw=0))
    axes.add_patch(Circle(tuple(tip + np.array([0, -1.3]) @ turned), 0.07, fc=X, lw=0))
    axes.text(9.15, 0.95, "TCP: the measured point", fontsize=8, color=X)
    frame(axes, (7.2, 5.5), {"x": (1.0, 0), "z": (0, -1.0)}, "rod base", (0.0, 0.55))
    frame(axes, tuple(tip), {"x": (0.74, -0.3), "z": (-0.3, -0.74)}, "tip", (1.25, -0.62))
    axes.add_patch(Polygon([(10.3, 3.5), (10.9, 3.5), (10.9, 4.2), (10.3, 4.2)], fc=METAL, ec=SIGNAL))
    axes.add_patch(Polygon([(10.3, 3.7), (10.05, 3.6), (10.05, 4.1), (10.3, 4.0)], fc=METAL, ec=SIGNAL))
    axes.plot([10.05, 8.0], [3.85, 2.35], color="0.6", lw=0.7, ls=":")
    axes.plot([10.05, 8.6], [3.85, 1.15], color="0.6", lw=0.7, ls=":")
    axes.text(10.6, 4.4, "camera", ha="center", fontsize=8)
    frame(axes, (10.05, 3.85), {"z": (-0.75, -0.6), "y": (0.05, -0.85)}, "", (0, 0))
    axes.annotate("", (5.75, 1.2), (5.75, 2.2), arrowprops={"arrowstyle": "-|>", "color": SIGNAL})
    axes.text(5.85, 1.6, "g", style="italic")


def control_loop(axes: Axes) -> None:
    """One valve's loop: from the source of set-points to the chamber and back."""
    axes.set(xlim=(-0.1, 14.0), ylim=(-1.6, 1.9))
    names = (
        "source:\nprotocol, stream,\ntip controller",
        "limiter",
        "reference",
        "regulator\nw = r' + k(r-p) + I",
        "inverse\nvalve model",
        "valve,\nchamber",
    )
    width, gap = 1.75, 0.5
    signals = ("P", "", "r", "w", "V", "p")
    for number, (name, signal) in enumerate(zip(names, signals, strict=True)):
        left = number * (width + gap)
        box(axes, (left, 0.6), (width, 1.0), name, METAL if number == 5 else "#f4f6f8")
        if number < 5:
            arrow(axes, [(left + width, 1.1), (left + width + gap, 1.1)], signal, offset=(0, 0.05))
    right = 5 * (width + gap) + width
    middle = 3 * (width + gap) + width / 2
    arrow(axes, [(right, 1.1), (right + 0.35, 1.1), (right + 0.35, -0.6), (10.5, -0.6)], "p", offset=(0.45, 0.02))
    box(axes, (8.6, -1.0), (1.9, 0.8), "sensor, card")
    arrow(axes, [(8.6, -0.6), (middle, -0.6), (middle, 0.6)], "measured p", offset=(0.1, 0.03))
    box(axes, (2.6, -1.0), (2.9, 0.8), "interlocks:\nstop latches, safe state", "#fbe9e7")
    arrow(axes, [(middle, -0.6), (5.5, -0.6)])
    arrow(
        axes,
        [(4.0, -1.0), (4.0, -1.35), (12.1, -1.35), (12.1, 0.6)],
        "safe outputs",
        colour=X,
        dashed=True,
        offset=(0, 0.02),
    )


def tip_loop(axes: Axes) -> None:
    """The tip controller around the pressure control."""
    axes.set(xlim=(-0.1, 12.6), ylim=(-2.0, 2.5))
    box(axes, (0, 0.9), (1.7, 0.9), "reference r(t)")
    box(axes, (2.6, 1.5), (2.2, 0.8), "feed-forward\n(before the run)")
    box(axes, (2.6, 0.2), (2.2, 0.9), "horizon:\nquadratic program")
    box(axes, (5.9, 0.6), (1.8, 1.0), "plan follower\nand limits")
    box(axes, (8.3, 0.6), (1.6, 1.0), "pressure\ncontrol")
    box(axes, (10.5, 0.6), (1.4, 1.0), "arm", SOFT)
    box(axes, (8.3, -1.6), (3.6, 0.8), "camera or tracker: z, 30 times a second")
    box(axes, (2.6, -1.6), (4.2, 0.8), "estimator: strengths, softness, lag, payload,\nperiodic disturbance")
    arrow(axes, [(1.7, 1.5), (2.15, 1.5), (2.15, 1.9), (2.6, 1.9)])
    arrow(axes, [(1.7, 1.2), (2.15, 1.2), (2.15, 0.65), (2.6, 0.65)])
    arrow(axes, [(4.8, 1.9), (5.35, 1.9), (5.35, 1.35), (5.9, 1.35)])
    arrow(axes, [(4.8, 0.65), (5.35, 0.65), (5.35, 0.9), (5.9, 0.9)], "plan", offset=(-0.25, -0.32))
    arrow(axes, [(7.7, 1.1), (8.3, 1.1)])
    arrow(axes, [(9.9, 1.1), (10.5, 1.1)], "P", offset=(0, 0.05))
    arrow(axes, [(11.2, 0.6), (11.2, -0.8)], "tip x", offset=(0.35, -0.1))
    arrow(axes, [(8.3, -1.2), (6.8, -1.2)], "z", offset=(0, 0.05))
    arrow(axes, [(3.7, -0.8), (3.7, 0.2)], "states", offset=(-0.35, -0.1))
    arrow(axes, [(6.8, 0.6), (6.8, -0.3), (5.6, -0.3), (5.6, -0.8)], "commanded set-points", offset=(0.55, -0.28))


def tube_to_tip(axes: Axes) -> None:
    """A tube with its forces, the cross-section of the paper's arm, and the arm under pressure."""
    axes.set(xlim=(-0.6, 12.4), ylim=(-0.6, 5.5))
    axes.text(1.2, 5.25, "tube", ha="center", weight="bold")
    axes.add_patch(Rectangle((0.5, 0.9), 1.4, 3.0, fc=SOFT, ec=SIGNAL))
    axes.add_patch(Rectangle((0.8, 0.9), 0.8, 3.0, fc="white", ec=SIGNAL, lw=0.7))
    for height in np.arange(1.1, 3.9, 0.25):
        axes.plot([0.5, 0.8], [height, height + 0.08], color="0.4", lw=0.8)
        axes.plot([1.6, 1.9], [height + 0.08, height], color="0.4", lw=0.8)
    axes.text(1.2, 2.4, "P", ha="center", color=AIR, fontsize=12)
    arrow(axes, [(1.2, 3.2), (1.2, 4.5)], "push p A", colour=AIR, offset=(0.0, 0.67))
    for left in (0.65, 1.75):
        arrow(axes, [(left, 4.5), (left, 3.9)], colour=X)
    axes.text(0.0, 4.15, "wall\nforce n", color=X, fontsize=8, ha="center", va="center")
    axes.text(1.2, 0.45, "e = aP + a$_1$n + a$_2$n$^2$", ha="center")
    axes.text(5.2, 5.25, "cross-section", ha="center", weight="bold")
    centre, pitch, outer, inner = np.array([5.2, 2.4]), 1.15, 0.62, 0.38
    for number, angle in enumerate(np.deg2rad([0, 120, 240]), 1):
        place = centre + pitch * np.array([np.cos(angle), np.sin(angle)])
        axes.add_patch(Circle(tuple(place), outer, fc=SOFT, ec=SIGNAL))
        axes.add_patch(Circle(tuple(place), inner, fc="white", ec=SIGNAL, lw=0.7))
        axes.text(*place, str(number), ha="center", va="center", color=AIR)
    frame(axes, tuple(centre), {"x": (0.5, 0.0), "y": (0.0, 0.5)}, "", (0, 0))
    axes.text(5.2, 0.1, "sum over tubes: total wrench n, m\n= walls less gas", ha="center")
    axes.text(9.9, 5.25, "arm", ha="center", weight="bold")
    scale, origin = 16.0, np.array([10.8, 4.3])
    for bar in (0.0, 0.35, 0.6):
        line = statics(Arm.paper(), bar * PA_PER_BAR * np.array([1.0, 0.0, 0.0])).p_m
        shown = origin + scale * np.column_stack([line[:, 0], -line[:, 2]])
        axes.plot(shown[:, 0], shown[:, 1], color="#a9772f", lw=2.5 if bar else 1.2, alpha=1.0 if bar else 0.5)
        axes.text(shown[-1, 0], shown[-1, 1] - 0.35, f"{bar:g} bar" if bar else "0", fontsize=8, ha="center")
    axes.add_patch(Rectangle((10.2, 4.3), 1.2, 0.15, fc=METAL, ec=SIGNAL))
    frame(axes, tuple(origin), {"x": (0.75, 0.0), "z": (0.0, -0.75)}, "rod base", (1.1, 0.35))
    axes.text(9.9, -0.35, "p' = R v,  R' = R û,  n' = .., m' = ..", ha="center")
    for left in (2.9, 7.4):
        arrow(axes, [(left, 2.4), (left + 0.6, 2.4)])


DRAWINGS: dict[str, tuple[Callable[[Axes], None], Point]] = {
    "bench": (bench, (8.6, 5.2)),
    "control-loop": (control_loop, (9.6, 2.8)),
    "tip-loop": (tip_loop, (9.2, 3.3)),
    "tube-to-tip": (tube_to_tip, (9.2, 4.2)),
}


def write(place: Path) -> None:
    """Write every drawing as SVG."""
    place.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context(STYLE):
        for name, (draw, size) in DRAWINGS.items():
            figure = Figure(figsize=size)
            axes = figure.add_axes((0, 0, 1, 1))
            axes.set_aspect("equal")
            axes.axis("off")
            draw(axes)
            figure.savefig(place / f"{name}.svg", metadata={"Date": None}, transparent=True)


if __name__ == "__main__":
    write(PLACE)
