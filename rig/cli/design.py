"""`rig design`: the protocol that makes the error bars of an identification smallest."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rig.cli.options import AsJson, Free, OutputFile, Replace, RigName, Seed

Duration = Annotated[float, typer.Option("--duration-s", metavar="S", help="Longest duration of the protocol.")]
Criterion = Annotated[
    str,
    typer.Option(
        "--criterion", metavar="NAME", help="d: smallest confidence volume; minimax: smallest largest error bar."
    ),
]


def design(
    free: Free = "",
    rig: RigName = None,
    duration_s: Duration = 60.0,
    criterion: Criterion = "d",
    seed: Seed = 0,
    to: OutputFile = Path("design.yaml"),
    replace: Replace = False,
    json: AsJson = False,
) -> None:
    """Write the protocol that makes the error bars of an identification smallest.

    Without --free: the default parameters of `rig identify` for motions, and the shear ratio.
    """
    import json as json_text

    from rig.cli.column_table import ColumnTable
    from rig.cli.console import console
    from rig.config.loader import chosen_rig, read
    from rig.design.design import LIBRARY
    from rig.design.design import design as find
    from runs.overwriting import refuse_existing

    refuse_existing([to], replace=replace)
    names = [name.strip() for name in free.split(",") if name.strip()]
    found = find(read(chosen_rig(rig).name).config, names, duration_s, criterion, seed)
    to.parent.mkdir(parents=True, exist_ok=True)
    to.write_text(found.text, encoding="utf-8")
    bars, library = found.bars, found.library
    if json:
        numbers = zip(bars.values.tolist(), bars.std.tolist(), library.std.tolist(), strict=True)
        labels = zip(bars.names, bars.units, bars.decided.tolist(), strict=True)
        rows = {
            name: {"value": value, "std": std, "std_library": other, "unit": unit, "identified": decided}
            for (name, unit, decided), (value, std, other) in zip(labels, numbers, strict=True)
        }
        typer.echo(json_text.dumps({"protocol": str(to), "parameters": rows}, indent=2))
        return
    table = ColumnTable()
    for head in ("parameter", "value", "design +-", "library +-", "ratio", "unit", "identified"):
        table.add_column(head)
    words = ["yes" if decided else "no" for decided in bars.decided]
    for name, value, std, other, unit, said in zip(
        bars.names, bars.values, bars.std, library.std, bars.units, words, strict=True
    ):
        table.add_row(name, f"{value:.4g}", f"{std:.3g}", f"{other:.3g}", f"{std / other:.2f}", unit, said)
    screen = console()
    screen.print(table)
    screen.print(f"expected standard errors; library: {', '.join(LIBRARY)} together")
    typer.echo(to)
