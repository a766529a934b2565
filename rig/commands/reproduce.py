"""`rig reproduce`: the paper's results beside ours."""

from __future__ import annotations

from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from rig.commands.options import AsJson


class Result(StrEnum):
    """What of the paper."""

    MODULUS = "modulus"
    TABLE3 = "table3"
    TABLE4 = "table4"
    TABLE5 = "table5"
    FIG9 = "fig9"
    FIG10 = "fig10"
    FIG11 = "fig11"
    FIG12 = "fig12"
    FIG13 = "fig13"
    FIG14 = "fig14"
    ALL = "all"


def reproduce(
    what: Annotated[Result, typer.Argument(help="The printed E (5.2.2), a table, a figure, or all of them.")],
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder of the figures and the page.", file_okay=False)
    ] = Path("data/paper"),
    runs: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Archives of the paper's six protocols; what is missing is simulated there. Default: --out/runs.",
            file_okay=False,
        ),
    ] = None,
    json: AsJson = False,
) -> None:
    """Compute a result of the paper again, beside the printed one, and say why they differ."""
    import json as writer

    from rich.table import Table

    from rig.paper.compared import Compared, Drawing
    from rig.screens import console

    screen = console(stderr=json)
    told = console(stderr=True)
    found: dict[str, object] = {}
    rows: list[Compared] = []
    drawings: list[Drawing] = []
    remarks: list[str] = []
    everything = what is Result.ALL
    if what is Result.MODULUS or everything:
        from calibration.identify.paper import published_modulus

        modulus = published_modulus()
        found["modulus"] = asdict(modulus)
        remarks.append(f"E of 5.2.2: {modulus.explanation}")
        screen.print(f"{remarks[-1]}\n", soft_wrap=True)
    if what is Result.TABLE3 or everything:
        from rig.table3 import table3, verdict

        rules = table3()
        found["table3"] = {"rows": [asdict(row) for row in rules], "verdict": verdict(rules)}
        remarks.append(f"Table 3, by the printed numbers alone: {verdict(rules)}")
        table = Table(box=None, padding=(0, 2, 0, 0), title="Table 3: mean distance from the inhomogeneous model [%]")
        for head in ("rule for E_i", "reading of the error", "no RPE", "with RPE", "possible"):
            table.add_column(head)
        table.add_row("printed", "", "17.20", "5.49", "")
        for row in rules:
            table.add_row(
                row.rule, row.reading, f"{row.homogeneous:.2f}", f"{row.radial:.2f}", "yes" if row.possible else "no"
            )
        screen.print(table)
        screen.print(f"{verdict(rules)}\n", soft_wrap=True)
    if what is Result.TABLE4 or everything:
        from rig.paper.everything import run_times
        from rig.reproduce import table4
        from rig.screens import table4 as shown

        methods = table4(told=lambda line: told.print(line))
        found["table4"] = [asdict(method) for method in methods]
        rows += run_times(methods)
        screen.print("Table 4: run times per simulated second, stability, errors against a converged reference")
        screen.print(shown(methods, 20.0))
    needing = [item.value for item in Result if item.value not in ("modulus", "table4", "all")]
    wanted = needing if everything else [what.value] if what.value in needing else []
    # What Table 3 says by the print alone needs no experiment, unless there are archives to hold it against.
    if wanted and not (what is Result.TABLE3 and runs is None):
        from rig.paper.everything import results
        from rig.screens import compared_table

        came = results(wanted, runs or out / "runs", everything, lambda line: told.print(line))
        rows += came.rows
        drawings += came.drawings
        found["compared"] = [asdict(row) for row in came.rows]
        screen.print(compared_table(came.rows))
    if drawings or everything:
        from rig.paper.page import write

        page = write(out, rows, drawings, remarks)
        screen.print(f"page and figures  {page}", soft_wrap=True)
    if json:
        typer.echo(writer.dumps(found, indent=2))
