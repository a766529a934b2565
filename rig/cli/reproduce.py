"""`rig reproduce`: the paper's results beside computed ones."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rig.cli.options import AsJson, Folder, Replace

if TYPE_CHECKING:
    from rig.reproduce.comparison import PaperComparison
    from runs.report.drawing import FigureSpecification


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
    from model.paper.identification import published_modulus
    from rig.cli import reproduction_output
    from rig.cli.output import console, print_json
    from rig.reproduce.all_results import NEEDS, results
    from rig.reproduce.page import write
    from rig.reproduce.table4 import drawing, run_times, table4

    screen, progress = console(stderr=json), console(stderr=True)
    everything = what is ReproducedResult.ALL
    facts: dict[str, object] = {}
    rows: list[PaperComparison] = []
    drawings: list[FigureSpecification] = []
    remarks: list[str] = []
    if everything or what is ReproducedResult.MODULUS:
        facts["modulus"] = modulus = published_modulus()
        remarks.append(f"E of 5.2.2: {modulus.explanation}")
    if everything or what is ReproducedResult.TABLE4:
        facts["table4"] = methods = table4(report=progress.print)
        rows += run_times(methods)
        drawings.append(drawing(methods))
        screen.print("Table 4: run times per simulated second, stability, errors against a converged reference")
        screen.print(reproduction_output.table4(methods))
    wanted = tuple(NEEDS) if everything else (what.value,) if what.value in NEEDS else ()
    if wanted:
        found = results(wanted, runs or out / "runs", everything, progress.print)
        facts["compared"], facts["verdicts"] = found.rows, found.verdicts
        rows += found.rows
        drawings += found.drawings
        remarks += found.verdicts
        screen.print(reproduction_output.compared(found.rows))
    for text in remarks:
        screen.print(f"{text}\n", soft_wrap=True)
    if drawings:
        screen.print(f"page and figures  {write(out, rows, drawings, remarks, replace=replace)}", soft_wrap=True)
    if json:
        print_json(facts)
