"""Output of `rig design`: expected error bars."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import typer

from calibration.identify.simulated_experiments import MeasurementErrors
from rig.cli.output import ColumnTable, console, print_json
from rig.design.design import LIBRARY, REPEATS, Design
from rig.design.expected_poses import errors_text


def error_bars(found: Design, to: Path, source: str, *, as_json: bool) -> None:
    """Print the expected standard errors of a design beside those of the library; source: run of the assumed errors."""
    bars = found.bars
    low, high = bars.by_arm.min(axis=0).tolist(), bars.by_arm.max(axis=0).tolist()
    std = (bars.std.tolist(), found.library.std.tolist(), found.repeated.std.tolist())
    labels = (bars.names, bars.units, bars.decided.tolist())
    rows = list(zip(*labels, bars.values.tolist(), low, high, *std, strict=True))
    if as_json:
        parameters = {
            name: {
                "value": value,
                "std": own,
                "std_of_arms": (least, most),
                "std_library": library,
                f"std_{REPEATS}_runs": repeated,
                "unit": unit,
                "identified": decided,
            }
            for name, unit, decided, value, least, most, own, library, repeated in rows
        }
        print_json({"protocol": str(to), "errors": _errors(found.errors, source), "parameters": parameters})
        return
    table = ColumnTable(
        "parameter", "value", "design +-", "of arms", "library +-", "ratio", f"{REPEATS} runs +-", "unit", "identified"
    )
    for name, unit, decided, value, least, most, own, library, repeated in rows:
        spread, ratio = f"{least:.2g}..{most:.2g}", f"{own / library:.2f}"
        numbers = (f"{value:.4g}", f"{own:.3g}", spread, f"{library:.3g}", ratio, f"{repeated:.2g}")
        table.add_row(name, *numbers, unit, "yes" if decided else "no")
    screen = console()
    screen.print(table)
    screen.print(
        f"expected standard errors: median and range of {len(bars.by_arm)} arms as uncertain as the rig's\n"
        f"library: {', '.join(LIBRARY)} together; {REPEATS} runs: of the design\n"
        f"{_assumed(found.errors, source, found.sections)}\n"
        "plateaus count as held for long: nothing relaxes\n"
        "of an arm that obeys the model; one that does not gets wider bars",
        soft_wrap=True,
    )
    typer.echo(to)


def _assumed(errors: MeasurementErrors, source: str, sections: Sequence[str] = ()) -> str:
    origin = f"in {source}" if source else "assumed; those of a run: --errors-of RUN"
    return f"standard deviations: {errors_text(errors, sections)} ({origin})"


def _errors(errors: MeasurementErrors, source: str) -> dict[str, object]:
    return {"source": source or None, **asdict(errors), "rest_pressure_pa": errors.plateau_pa}
