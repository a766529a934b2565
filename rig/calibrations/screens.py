"""What the calibration commands print."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from calibration.camera import PARAMETERS, CameraCalibration


def table(*heads: str, title: str | None = None) -> Table:
    """A plain table: the first column is text, the others numbers."""
    made = Table(box=None, padding=(0, 2, 0, 0), title=title, title_justify="left")
    for k, head in enumerate(heads):
        made.add_column(head, justify="right" if k else "left")
    return made


def camera_facts(found: CameraCalibration, file: Path, picture: Path) -> dict[str, Any]:
    """A camera's intrinsics for scripts."""
    fx, fy, cx, cy, *distortion = (float(p) for p in found.parameters)
    return {
        "file": str(file),
        "picture": str(picture),
        "width_px": found.width_px,
        "height_px": found.height_px,
        "fx_px": fx,
        "fy_px": fy,
        "cx_px": cx,
        "cy_px": cy,
        "distortion": distortion,
        "standard_uncertainty": dict(zip(PARAMETERS, map(float, found.std), strict=True)),
        "rms_px": found.rms_px,
        "coverage": found.coverage.share,
        "views": {view.name: {"rms_px": view.rms_px, "sha256": view.sha256} for view in found.views},
        "skipped": {view.name: view.reason for view in found.skipped},
        "advice": found.advice,
    }


def camera(found: CameraCalibration, name: str, screen: Console) -> None:
    """A camera's intrinsics, how well they fit, and what would make them better."""
    values = table("parameter", "value", "+-")
    for parameter, value, std in zip(PARAMETERS, found.parameters, found.std, strict=True):
        values.add_row(parameter, f"{value:.5f}" if abs(value) < 10 else f"{value:.2f}", f"{std:.2g}")
    screen.print(
        f"{name}: {len(found.views)} views of {found.width_px}x{found.height_px}, rms {found.rms_px:.3f} px, "
        f"{found.coverage.share:.0%} of the picture covered",
        soft_wrap=True,
    )
    screen.print(values)
    views = table("view", "rms [px]")
    for view in found.views:
        views.add_row(view.name, f"{view.rms_px:.3f}")
    screen.print(views)
    for left in found.skipped:
        screen.print(Text(f"not used: {left.name}: {left.reason}", "yellow"), soft_wrap=True)
    for line in found.advice:
        screen.print(Text(line, "yellow"), soft_wrap=True)
