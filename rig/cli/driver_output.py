"""Output of `rig drivers` and `rig test-driver`."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table
from rich.text import Text

from rig.cli.output import ColumnTable
from rig.driver_contract.check import CheckResult, CheckVerdict
from rig.hardware.installed_drivers import InstalledDriver

_STYLE = {
    CheckVerdict.PASS: "green",
    CheckVerdict.FAIL: "bold red",
    CheckVerdict.SKIPPED: "dim",
    CheckVerdict.NOT_JUDGED: "yellow",
}


def table(rows: Sequence[InstalledDriver]) -> Table:
    """Return the drivers as a table; a plug-in that cannot be used has its fault in red."""
    found = ColumnTable("section", "name", "package", "what it does")
    for row in rows:
        found.add_row(row.kind, row.name, row.package, Text(row.fault, "red") if row.fault else _about(row))
    return found


def _about(row: InstalledDriver) -> str:
    """What a driver drives, its keys, and what its outputs do once the program is dead."""
    parts = [row.about.rstrip(".") + (" (simulated)" if row.simulated else "")]
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
