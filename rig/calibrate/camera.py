"""`rig calibrate camera`: intrinsics from views of a board, with a figure of the residuals."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import typer

from calibration.camera import calibrate, calibrate_views
from calibration.views import View
from calibration.vision.board import Board
from rig.calibrate import file_sections, inputs, residual_figure
from rig.calibrate.inputs import bad_input
from rig.calibrate.view_collection import collect, pictures
from rig.cli import calibration_output
from rig.cli.console import console
from rig.cli.json_output import plain_json
from rig.cli.keyboard import Keyboard
from rig.config.calibration_files import default_path, views_beside, write
from rig.config.schema import RigConfig
from runs.overwriting import refuse_existing

_PICTURE = ".png"


@dataclass(frozen=True)
class CameraCalibrationRequest:
    """Options of the command."""

    views: tuple[str, ...]
    corners: str
    square_mm: float
    live: bool
    rig: str | None
    camera: str | None
    count: int
    every: int
    to: Path | None
    replace: bool
    note: str
    seed: int
    json: bool


def run(request: CameraCalibrationRequest) -> None:
    """Calibrate every named camera; write a file and a figure for each.

    Raises:
        BadInputError: the command line is invalid.
        ViewsError, CalibrationError: the views do not determine a camera.
        CameraError: a live camera delivers no pictures.
    """
    corners, square_m = inputs.corners_of(request.corners), inputs.square_of(request.square_mm)
    rig = inputs.rig_of(request.rig)
    screen = console(stderr=request.json)
    if request.to is not None:
        if len(request.views) > 1:
            raise bad_input(
                "--to", str(request.to), "one camera at a time; each of several gets a dated name of its own"
            )
        if request.to.suffix.lower() == _PICTURE:
            raise bad_input(
                "--to", str(request.to), "a name for the YAML file; the picture goes beside it with this ending"
            )
        refuse_existing([request.to], replace=request.replace)
        refuse_existing([request.to.with_suffix(_PICTURE)], replace=request.replace)
    if request.live:
        if request.views:
            raise bad_input("--live", request.views[0], "either views that are there or live ones")
        if rig is None:
            raise bad_input("--live", "", "--rig as well: whose camera is it?")
        name = inputs.known_camera(rig, request.camera or next(iter(rig.cameras)))
        file = request.to or default_path(f"camera-{name}")
        views = _live(request, rig, name, corners, square_m, file)
        listed = [(name, file, calibrate_views(views, corners, square_m))]
    else:
        if not request.views:
            raise bad_input("VIEWS", "", "a folder, a video or a pattern of the board's pictures; or --live")
        if request.camera is not None and rig is not None:
            inputs.known_camera(rig, request.camera)
        listed = [
            (
                s.camera,
                request.to or default_path(f"camera-{s.camera}"),
                calibrate(s.views, corners, square_m, request.every),
            )
            for s in inputs.sources_of(list(request.views), rig, request.camera)
        ]
    facts = {}
    for name, file, found in listed:
        made = write(
            file_sections.camera_file(found, inputs.identity(rig, name, found), request.note),
            file,
            replace=request.replace,
        )
        drawn = residual_figure.write(found, f"camera {name}", made.with_suffix(_PICTURE))
        facts[name] = calibration_output.camera_facts(found, made, drawn)
        if not request.json:
            calibration_output.camera(found, name, screen)
            _finish(made, drawn, rig, name)
    if request.json:
        only = next(iter(facts.values())) if len(facts) == 1 else {"cameras": facts}
        typer.echo(json.dumps(plain_json(only), indent=2))


def _finish(made: Path, drawn: Path, rig: RigConfig | None, name: str) -> None:
    mock = rig is not None and name in rig.cameras and rig.cameras[name].simulated
    typer.echo(f"{calibration_output.written(made, mock)}\n{drawn}")
    if rig is None:
        typer.echo("to use it, give the camera's name with NAME=VIEWS and put the file under `calibrations:` of a rig")


def _live(
    request: CameraCalibrationRequest, rig: RigConfig, name: str, corners: tuple[int, int], square_m: float, file: Path
) -> list[View]:
    """Views from the rig's camera, kept as pictures beside the file."""
    board = Board(corners[0] + 1, corners[1] + 1, square_m)
    folder = views_beside(file, request.replace)
    typer.echo(f"views go to {folder}; Enter: enough, Ctrl-C: give up", err=True)
    with Keyboard() as keys:
        return collect(
            pictures(rig, name, board, request.seed),
            corners,
            request.count,
            folder,
            lambda line: typer.echo(line, err=True),
            lambda: "\n" in keys.pressed(),
        )
