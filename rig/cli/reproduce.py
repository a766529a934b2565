"""`rig reproduce`: the paper's results beside computed ones."""

from __future__ import annotations

from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from rig.cli.options import AsJson, Folder, Replace


class ReproducedResult(StrEnum):
    """Results of the paper that can be reproduced."""

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
    what: Annotated[ReproducedResult, typer.Argument(help="The printed E (5.2.2), a table, a figure, or all of them.")],
    out: Folder = Path("data/paper"),
    runs: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Archives of the paper's six protocols; what is missing is simulated there.",
            file_okay=False,
            show_default="runs, in the folder of --out",
        ),
    ] = None,
    replace: Replace = False,
    json: AsJson = False,
) -> None:
    """Compute a result of the paper beside the printed one, and explain the difference."""
    import json as writer

    from rig.cli import reproduction_output
    from rig.cli.console import console
    from rig.reproduce.comparison import PaperComparison, PaperFigure

    screen, progress = console(stderr=json), console(stderr=True)
    everything = what is ReproducedResult.ALL
    found: dict[str, object] = {}
    rows: list[PaperComparison] = []
    drawings: list[PaperFigure] = []
    remarks: list[str] = []
    if what is ReproducedResult.MODULUS or everything:
        from calibration.identify.paper_identification import published_modulus

        modulus = published_modulus()
        found["modulus"] = asdict(modulus)
        remarks.append(f"E of 5.2.2: {modulus.explanation}")
        screen.print(f"{remarks[-1]}\n", soft_wrap=True)
    if what is ReproducedResult.TABLE3 or everything:
        from rig.reproduce.table3 import table3, verdict

        rules = table3()
        conclusion = verdict(rules)
        found["table3"] = {"rows": [asdict(row) for row in rules], "verdict": conclusion}
        remarks.append(f"Table 3, by the printed numbers alone: {conclusion}")
        screen.print(reproduction_output.table3(rules))
        screen.print(f"{conclusion}\n", soft_wrap=True)
    if what is ReproducedResult.TABLE4 or everything:
        from rig.reproduce.table4 import drawing, run_times, table4

        methods = table4(report=lambda line: progress.print(line))
        found["table4"] = [asdict(method) for method in methods]
        rows += run_times(methods)
        drawings.append(drawing(methods))
        screen.print("Table 4: run times per simulated second, stability, errors against a converged reference")
        screen.print(reproduction_output.table4(methods))
    from rig.reproduce.all_results import NEEDS, results

    wanted = tuple(NEEDS) if everything else (what.value,) if what.value in NEEDS else ()
    # The analysis of the printed Table 3 needs no experiment unless archives are given.
    if wanted and not (what is ReproducedResult.TABLE3 and runs is None):
        reproduced = results(wanted, runs or out / "runs", everything, lambda line: progress.print(line))
        rows += reproduced.rows
        drawings += reproduced.drawings
        found["compared"] = [asdict(row) for row in reproduced.rows]
        screen.print(reproduction_output.compared(reproduced.rows))
        found["verdicts"] = list(reproduced.verdicts)
        remarks += reproduced.verdicts
        for sentence in reproduced.verdicts:
            screen.print(f"\n{sentence}", soft_wrap=True)
    if drawings:
        from rig.reproduce.page import write

        page = write(out, rows, drawings, remarks, replace=replace)
        screen.print(f"page and figures  {page}", soft_wrap=True)
    if json:
        typer.echo(writer.dumps(found, indent=2))
