"""`rig reproduce`: the paper's results beside computed ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rig.cli.options import AsJson, Folder, Replace

if TYPE_CHECKING:
    from rich.console import Console

    from rig.reproduce.comparison import PaperComparison, PaperFigure


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
    from rig.cli.console import console
    from rig.cli.json_output import print_json
    from rig.reproduce.all_results import NEEDS

    screen, progress = console(stderr=json), console(stderr=True)
    everything = what is ReproducedResult.ALL
    shown = Reproduction(screen, lambda line: progress.print(line))
    for name, compute in _WITHOUT_ARCHIVES.items():
        if what is name or everything:
            compute(shown)
    wanted = tuple(NEEDS) if everything else (what.value,) if what.value in NEEDS else ()
    if wanted:
        _from_archives(shown, wanted, runs or out / "runs", everything)
    if shown.drawings:
        from rig.reproduce.page import write

        page = write(out, shown.rows, shown.drawings, shown.remarks, replace=replace)
        screen.print(f"page and figures  {page}", soft_wrap=True)
    if json:
        print_json(shown.facts)


@dataclass
class Reproduction:
    """The screen, and what has been computed: facts for JSON, and the content of the page."""

    screen: Console
    report: Callable[[str], None]
    facts: dict[str, object] = field(default_factory=dict)
    rows: list[PaperComparison] = field(default_factory=list)
    drawings: list[PaperFigure] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def remark(self, text: str) -> None:
        """Print a sentence that is also on the page."""
        self.remarks.append(text)
        self.screen.print(f"{text}\n", soft_wrap=True)


def _modulus(shown: Reproduction) -> None:
    from calibration.identify.paper_identification import published_modulus

    modulus = published_modulus()
    shown.facts["modulus"] = modulus
    shown.remark(f"E of 5.2.2: {modulus.explanation}")


def _table4(shown: Reproduction) -> None:
    from rig.cli import reproduction_output
    from rig.reproduce.table4 import drawing, run_times, table4

    methods = table4(report=shown.report)
    shown.facts["table4"] = methods
    shown.rows += run_times(methods)
    shown.drawings.append(drawing(methods))
    shown.screen.print("Table 4: run times per simulated second, stability, errors against a converged reference")
    shown.screen.print(reproduction_output.table4(methods))


_WITHOUT_ARCHIVES: dict[ReproducedResult, Callable[[Reproduction], None]] = {
    ReproducedResult.MODULUS: _modulus,
    ReproducedResult.TABLE4: _table4,
}
"""Results that need no archives, in the order in which they are shown."""


def _from_archives(shown: Reproduction, wanted: tuple[str, ...], archives: Path, errors_of_methods: bool) -> None:
    """Compare the results that need runs of the paper's protocols."""
    from rig.cli import reproduction_output
    from rig.reproduce.all_results import results

    found = results(wanted, archives, errors_of_methods, shown.report)
    shown.rows += found.rows
    shown.drawings += found.drawings
    shown.facts["compared"] = found.rows
    shown.facts["verdicts"] = found.verdicts
    shown.screen.print(reproduction_output.compared(found.rows))
    for sentence in found.verdicts:
        shown.remark(sentence)
