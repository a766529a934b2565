"""`rig calibrate`: from pictures and gauges to numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rig.commands.options import AsJson

app = typer.Typer(no_args_is_help=True, help="Calibrate a camera.")


@app.callback()
def group() -> None:
    """Calibrate what the rig measures with."""


@app.command()
def camera(
    views: Annotated[Path, typer.Argument(metavar="FOLDER|VIDEO", help="Pictures or a video of the board.")],
    corners: Annotated[str, typer.Option(help="Inner corners of the board, as 9x6.")],
    square_mm: Annotated[float, typer.Option(help="Edge of a square [mm].")],
    every: Annotated[int, typer.Option(help="Of a video, every so many frames.", min=1)] = 1,
    json: AsJson = False,
) -> None:
    """Find a camera's intrinsics and distortion from views of a checkerboard."""
    from calibration.camera import calibrate
    from rig import calibrated

    columns, cross, rows = corners.partition("x")
    if not (cross and columns.isdigit() and rows.isdigit()):
        raise typer.BadParameter(f"'{corners}' is not of the form 9x6", param_hint="--corners")
    calibrated.camera(calibrate(views, (int(columns), int(rows)), square_mm * 1e-3, every), json)
