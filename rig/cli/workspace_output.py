"""Output of `rig workspace`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Group

from protocols.problems import bad_input
from rig.cli.output import ColumnTable
from rig.config.schema import RigConfig
from runs.overwriting import refuse_existing

if TYPE_CHECKING:
    from rig.tip_planning.workspace import TipWorkspace

KINDS = (".png", ".pdf", ".svg")


def check_drawing(to: Path, replace: bool) -> None:
    """Refuse a file that is no drawing, or that may not be overwritten.

    Raises:
        BadInputError, WouldOverwriteError: before anything is computed.
    """
    if to.suffix.lower() not in KINDS:
        raise bad_input("--to", str(to), f"a file whose name ends with {', '.join(KINDS)}")
    refuse_existing([to, to.with_suffix(".csv")], replace=replace)


def save(space: TipWorkspace, to: Path) -> None:
    """Draw what can be reached."""
    from rig.tip_planning import workspace
    from runs.report import drawing

    to.parent.mkdir(parents=True, exist_ok=True)
    drawing.save(workspace.draw, (9, 4.6), to, space, mark="computed by the model")


def table(space: TipWorkspace, config: RigConfig) -> Group:
    """Return the extent and the sections as text."""
    low, high = space.height_mm
    limits = config.limits
    facts = (
        f"rig {config.name}, {len(config.valves)} valves, 0 to {limits.pressure_bar:g} bar, at rest:\n"
        f"z from {low:.1f} to {high:.1f} mm, up to {space.radius_mm:.1f} mm from the axis"
    )
    if not space.sections:
        return Group(facts, "two valves move the tip in a surface: control two coordinates, such as [x, z]")
    heads = ("z [mm]", "circles about the axis, radius [mm]", "farthest point from the axis [mm]")
    sections = ColumnTable(numbers=heads)
    for section in space.sections:
        circles = "none" if section.circles_mm is None else "{:.0f} to {:.0f}".format(*section.circles_mm)
        sections.add_row(f"{section.height_mm:.1f}", circles, f"{section.farthest_mm:.0f}")
    return Group(facts, sections)


def facts(space: TipWorkspace, config: RigConfig) -> dict[str, object]:
    """Return the same for JSON."""
    return {
        "rig": config.name,
        "height_mm": space.height_mm,
        "radius_mm": space.radius_mm,
        "sections": [
            {
                "height_mm": section.height_mm,
                "circles_mm": section.circles_mm,
                "farthest_mm": section.farthest_mm,
            }
            for section in space.sections
        ],
    }
