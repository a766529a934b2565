"""`rig reproduce`: the paper's results beside ours."""

from __future__ import annotations

from dataclasses import asdict
from enum import StrEnum
from typing import Annotated

import typer

from rig.commands.options import AsJson


class Result(StrEnum):
    """What of the paper."""

    MODULUS = "modulus"
    TABLE3 = "table3"
    TABLE4 = "table4"
    ALL = "all"


def reproduce(
    what: Annotated[Result, typer.Argument(help="The printed E (5.2.2), Table 3, Table 4, or all of them.")],
    json: AsJson = False,
) -> None:
    """Compute a result of the paper again, beside the printed one, and say why they differ."""
    import json as writer

    from rich.table import Table

    from rig.screens import console

    screen = console(stderr=json)
    found: dict[str, object] = {}
    if what in (Result.MODULUS, Result.ALL):
        from calibration.identify.paper import published_modulus

        modulus = published_modulus()
        found["modulus"] = asdict(modulus)
        screen.print(f"E of 5.2.2: {modulus.explanation}\n", soft_wrap=True)
    if what in (Result.TABLE3, Result.ALL):
        from rig.table3 import table3, verdict

        rows = table3()
        found["table3"] = {"rows": [asdict(row) for row in rows], "verdict": verdict(rows)}
        table = Table(box=None, padding=(0, 2, 0, 0), title="Table 3: mean distance from the inhomogeneous model [%]")
        for head in ("rule for E_i", "reading of the error", "no RPE", "with RPE", "possible"):
            table.add_column(head)
        table.add_row("printed", "", "17.20", "5.49", "")
        for row in rows:
            table.add_row(
                row.rule, row.reading, f"{row.homogeneous:.2f}", f"{row.radial:.2f}", "yes" if row.possible else "no"
            )
        screen.print(table)
        screen.print(f"{verdict(rows)}\n", soft_wrap=True)
    if what in (Result.TABLE4, Result.ALL):
        from rig.reproduce import table4

        methods = table4()
        found["table4"] = [asdict(method) for method in methods]
        table = Table(box=None, padding=(0, 2, 0, 0), title="Table 4: seconds per simulated second, error in mm rms")
        for head in ("in space", "in time", "steps", "printed", "same method", "live solver", "error", "stable for"):
            table.add_column(head)
        for method in methods:
            printed = "unstable" if method.printed_s is None else f"{method.printed_s:.4f}"
            table.add_row(
                method.space, method.scheme, str(method.steps), printed, f"{method.faithful_s:.4f}",
                f"{method.ours_s:.4f}", f"{method.error_mm:.4f}", f"{method.held_s:.3g} s",
            )  # fmt: skip
        screen.print(table)
    if json:
        typer.echo(writer.dumps(found, indent=2))
