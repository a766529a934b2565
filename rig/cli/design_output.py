"""Output of `rig design`: expected error bars, or the expected separation of two laws."""

from __future__ import annotations

from pathlib import Path

import typer

from rig.cli.column_table import ColumnTable
from rig.cli.console import console
from rig.cli.json_output import print_json
from rig.design.design import LIBRARY, Design
from rig.design.law_comparison import RIGHT, LawDesign, share_text


def error_bars(found: Design, to: Path, as_json: bool) -> None:
    """Print the expected standard errors of a design beside those of the library."""
    bars, library, limit = found.bars, found.library.std.tolist(), found.limit.std.tolist()
    numbers = list(zip(bars.values.tolist(), bars.std.tolist(), library, limit, strict=True))
    labels = list(zip(bars.names, bars.units, bars.decided.tolist(), strict=True))
    if as_json:
        rows = {
            name: {
                "value": value,
                "std": std,
                "std_library": other,
                "std_limit": least,
                "unit": unit,
                "identified": decided,
            }
            for (name, unit, decided), (value, std, other, least) in zip(labels, numbers, strict=True)
        }
        print_json({"protocol": str(to), "parameters": rows})
        return
    table = ColumnTable("parameter", "value", "design +-", "library +-", "ratio", "limit +-", "unit", "identified")
    for (name, unit, decided), (value, std, other, least) in zip(labels, numbers, strict=True):
        shown = (f"{value:.4g}", f"{std:.3g}", f"{other:.3g}", f"{std / other:.2f}", f"{least:.2g}")
        table.add_row(name, *shown, unit, "yes" if decided else "no")
    screen = console()
    screen.print(table)
    screen.print(
        f"expected standard errors; library: {', '.join(LIBRARY)} together; limit: any number of such blocks\n"
        "from positions of the tip, without its orientations; plateaus count as held for long: nothing relaxes\n"
        "of an arm that obeys the model: `rig identify` adds the errors of the model that the run shows, and holds a "
        "parameter that they leave open, also one with yes above",
        soft_wrap=True,
    )
    typer.echo(to)


def separations(found: LawDesign, to: Path, as_json: bool) -> None:
    """Print the expected share of right decisions, with either law true."""
    if as_json:
        rows = [
            {
                "true": one.truth,
                "rival": one.rival,
                "distance": one.distance2**0.5,
                "right": one.share,
                "bound": not one.separable,
            }
            for one in found.separations
        ]
        facts = {"protocol": str(to), "sufficient": found.sufficient, "cases": rows}
        print_json(facts)
        return
    table = ColumnTable("true law", "rival", "distance", "right decisions")
    for one in found.separations:
        distance = f"{one.distance2**0.5:.3g}" if one.separable else "0"
        table.add_row(one.truth, one.rival, distance, share_text(one))
    screen = console()
    screen.print(table)
    screen.print(
        f"distance: of the predictions, in standard errors, after a fit of the rival; {len(found.planned)} plateaus",
        soft_wrap=True,
    )
    for one in found.separations:
        if not one.separable:
            screen.print(
                f"{one.rival} contains {one.truth}: no pressures tell them apart if {one.truth} is true. Only the "
                "number of parameters then decides, or `rig identify compare` says that the data do not decide.",
                soft_wrap=True,
            )
    if all(one.separable for one in found.separations) and not found.sufficient:
        screen.print(
            f"fewer than {100 * RIGHT:.0f} % right decisions are expected: allow more --duration-s", soft_wrap=True
        )
    typer.echo(to)
