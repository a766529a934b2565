"""What the calibration commands print."""

from __future__ import annotations

import json

import typer
from rich.table import Table
from rich.text import Text

from calibration.camera import PARAMETERS, CameraCalibration
from rig.listing import plain_json
from rig.screens import console


def camera(found: CameraCalibration, as_json: bool) -> None:
    """A camera's intrinsics, how well they fit, and what would make them better."""
    fx, fy, cx, cy, *distortion = (float(p) for p in found.parameters)
    if as_json:
        facts = {
            "width_px": found.width_px,
            "height_px": found.height_px,
            "fx_px": fx,
            "fy_px": fy,
            "cx_px": cx,
            "cy_px": cy,
            "distortion": distortion,
            "standard_uncertainty": dict(zip(PARAMETERS, map(float, found.std), strict=True)),
            "rms_px": found.rms_px,
            "coverage": found.coverage,
            "views": {view.name: {"rms_px": view.rms_px, "sha256": view.sha256} for view in found.views},
            "skipped": dict(found.skipped),
            "advice": found.advice,
        }
        typer.echo(json.dumps(plain_json(facts), indent=2))
        return
    table = Table(box=None, padding=(0, 2, 0, 0))
    for head in ("parameter", "value", "+-"):
        table.add_column(head, justify="left" if head == "parameter" else "right")
    for name, value, std in zip(PARAMETERS, found.parameters, found.std, strict=True):
        table.add_row(name, f"{value:.5f}" if abs(value) < 10 else f"{value:.2f}", f"{std:.2g}")
    screen = console()
    screen.print(f"{len(found.views)} views of {found.width_px}x{found.height_px}, rms {found.rms_px:.3f} px")
    screen.print(table)
    for name, why in found.skipped:
        screen.print(Text(f"not used: {name}: {why}", "yellow"))
    for line in found.advice:
        screen.print(Text(line, "yellow"))
    rounded = ", ".join(f"{d:.6f}" for d in distortion)
    lens = f"fx_px: {fx:.3f}, fy_px: {fy:.3f}, cx_px: {cx:.3f}, cy_px: {cy:.3f}, distortion: [{rounded}]"
    screen.print(f"for the rig's file:  lens: {{{lens}}}", soft_wrap=True)
