"""Output of `rig reproduce`."""

from __future__ import annotations

from rich.table import Table

from rig.cli.output import ColumnTable
from rig.reproduce.comparison import PaperComparison
from rig.reproduce.table4 import HORIZON_S, Table4Row


def compared(rows: tuple[PaperComparison, ...]) -> Table:
    """Return the paper's results beside the computed ones."""
    table = ColumnTable("item", "what", "paper", "here", "by", "why different")
    for row in rows:
        table.add_row(row.item, row.what, row.paper, row.computed, row.origin, row.why)
    return table


def table4(rows: tuple[Table4Row, ...]) -> Table:
    """Return the paper's Table 4 beside computed values; times are per simulated second."""
    table = Table(box=None, padding=(0, 2, 0, 0))
    for head in ("along the arm", "N", "in time", "paper [s]", "its method [s]", "ours [ms]", "holds for [s]"):
        table.add_column(head, justify="left" if head in ("along the arm", "in time") else "right", no_wrap=True)
    for head in ("error [mm]", "ours [mm]"):
        table.add_column(head, justify="right")
    for row in rows:
        table.add_row(
            row.space,
            str(row.steps),
            row.scheme,
            "unstable" if row.printed_s is None else f"{row.printed_s:.4f}",
            f"{row.faithful_s:.4f}",
            f"{row.ours_s * 1e3:.3f}",
            f"{row.held_s:.1f}" if row.held_s < HORIZON_S else f"> {HORIZON_S:g}",
            f"{row.error_mm:.4f}",
            f"{row.ours_error_mm:.4f}",
        )
    return table
