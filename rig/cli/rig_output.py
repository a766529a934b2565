"""Output of the commands about a rig and its drivers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Group
from rich.table import Table
from rich.text import Text

from protocols.problems import bad_input
from rig.cli.output import ColumnTable
from rig.config.drivers import Finding
from rig.config.schema import RigConfig
from rig.conformance.check import CheckResult, CheckVerdict
from rig.hardware.installed_drivers import InstalledObject
from runs.overwriting import refuse_existing

if TYPE_CHECKING:
    from rig.tip_planning.workspace import TipWorkspace

_VERDICT = {"ok": "green", "missing": "bold red", "note": "yellow"}
_STYLE = {
    CheckVerdict.PASS: "green",
    CheckVerdict.FAIL: "bold red",
    CheckVerdict.SKIPPED: "dim",
}
_DRAWINGS = (".png", ".pdf", ".svg")
COORDINATES = 3


def check_drawing(to: Path, replace: bool) -> None:
    """Refuse a file that is no drawing, or that may not be overwritten.

    Raises:
        BadInputError, WouldOverwriteError: before anything is computed.
    """
    if to.suffix.lower() not in _DRAWINGS:
        raise bad_input("--to", str(to), f"a file whose name ends with {', '.join(_DRAWINGS)}")
    refuse_existing([to, to.with_suffix(".csv")], replace=replace)


def save_drawing(space: TipWorkspace, to: Path) -> None:
    """Draw what can be reached."""
    from rig.tip_planning import workspace
    from runs.report import drawing

    to.parent.mkdir(parents=True, exist_ok=True)
    drawing.save(workspace.draw, (9, 4.6), to, space, mark="computed by the model")


def workspace_table(space: TipWorkspace, config: RigConfig) -> Group:
    """Return the extent and the sections as text."""
    low, high = space.height_mm
    limits = config.limits
    facts = (
        f"rig {config.name}, {len(config.valves)} valves, 0 to {limits.pressure_bar:g} bar, at rest:\n"
        f"z from {low:.1f} to {high:.1f} mm, up to {space.radius_mm:.1f} mm from the axis"
    )
    if len(config.valves) > COORDINATES:
        return Group(facts, "more valves than coordinates: the tip reaches a point with many pressures")
    if not space.sections:
        return Group(facts, "two valves move the tip in a surface: control two coordinates, such as [x, z]")
    heads = ("z [mm]", "circles about the axis, radius [mm]", "farthest point from the axis [mm]")
    sections = ColumnTable(numbers=heads)
    for section in space.sections:
        circles = "none" if section.circles_mm is None else "{:.0f} to {:.0f}".format(*section.circles_mm)
        sections.add_row(f"{section.height_mm:.1f}", circles, f"{section.farthest_mm:.0f}")
    return Group(facts, sections)


def workspace_facts(space: TipWorkspace, config: RigConfig) -> dict[str, object]:
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


def findings_table(findings: Sequence[Finding]) -> Table:
    """Return the findings of `rig doctor` as a table."""
    table = ColumnTable("", "topic", "found", "what to do")
    for finding in findings:
        remedy = "" if finding.verdict == "ok" else finding.remedy
        table.add_row(Text(finding.verdict, _VERDICT[finding.verdict]), finding.topic, finding.found, remedy)
    return table


def drivers_table(rows: Sequence[InstalledObject]) -> Table:
    """Return the drivers as a table; a plug-in that cannot be used has its fault in red."""
    found = ColumnTable("section", "name", "package", "what it does")
    for row in rows:
        found.add_row(row.kind, row.name, row.package, Text(row.fault, "red") if row.fault else _about(row))
    return found


def _about(row: InstalledObject) -> str:
    """What a driver drives, its keys, and what its outputs do once the program is dead."""
    about = row.about if row.about.endswith("..") else row.about.removesuffix(".")
    parts = [about + (" (simulated)" if row.simulated else "")]
    if row.keys:
        parts.append(f"keys: {', '.join(row.keys)}")
    if row.safe_state:
        parts.append(f"if the program dies: {row.safe_state}")
    return "; ".join(parts)


def result_line(result: CheckResult) -> Text:
    """Return one result as it comes."""
    line = Text(f"{result.device}, {result.check}: ")
    return line.append(result.verdict, _STYLE[result.verdict])


def results_table(results: Sequence[CheckResult]) -> Table:
    """Return the results of `rig test-driver`; a failed check has what softrig relies on below."""
    found = ColumnTable("", "device", "check", "found")
    for result in results:
        words = f"{result.found}\nexpected: {result.expected}" if result.failed else result.found
        found.add_row(Text(result.verdict, _STYLE[result.verdict]), result.device, result.check, words)
    return found
