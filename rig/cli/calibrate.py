"""`rig calibrate`: commands for cameras, DLT, tool and pressures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rig.cli.options import AsJson, Fast, Note, Replace, RigName, Seed, Yes

app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Calibrate cameras, DLT, tool and pressures; each writes a dated file.",
)

Corners = Annotated[str, typer.Option(help="Inner corners of the board, as 9x6.")]
SquareMm = Annotated[float, typer.Option(help="Edge of a square [mm].")]
Every = Annotated[int, typer.Option(help="Use every Nth frame of a video.", min=1)]
RigFile = Annotated[str | None, typer.Option("--rig", help="Rig whose cameras these are: name or file.")]
To = Annotated[Path | None, typer.Option("--to", metavar="FILE", help="Output file; default: a dated name.")]


@app.callback()
def group() -> None:
    """Calibrate the rig's sensors."""


@app.command()
def dlt(
    given: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="CSV|NAME=VIEWS..", help="Control points, or each camera's simultaneous views of a board."
        ),
    ] = None,
    corners: Corners = "",
    square_mm: SquareMm = 0.0,
    calibration: Annotated[
        list[Path] | None, typer.Option(metavar="FILE", help="A camera's calibration, to remove its lens distortion.")
    ] = None,
    rig: RigFile = None,
    size: Annotated[str, typer.Option(help="Size of the pictures, as 640x480, if no other option gives it.")] = "",
    points_std_mm: Annotated[
        float, typer.Option(help="Standard uncertainty of the control points, for the bundle adjustment.")
    ] = 0.0,
    bundle: Annotated[bool, typer.Option(help="Refine by bundle adjustment.")] = True,
    world_view: Annotated[str, typer.Option(help="View whose board defines the world frame.")] = "",
    base: Annotated[
        str,
        typer.Option(
            metavar="X,Y,Z,A,B,C", help="Pose of that board in the rod-base frame: mm, rotation vector in deg."
        ),
    ] = "",
    every: Every = 1,
    to: To = None,
    replace: Replace = False,
    note: Note = "",
    json: AsJson = False,
) -> None:
    """Find cameras' 11 DLT coefficients and poses, from control points or from views of a board."""
    from rig.calibrate import dlt as procedure

    procedure.run(
        procedure.DLTCalibrationRequest(
            given=tuple(given or ()),
            corners=corners,
            square_mm=square_mm,
            calibrations=tuple(calibration or ()),
            rig=rig,
            size=size,
            points_std_mm=points_std_mm,
            bundle=bundle,
            world_view=world_view,
            base=base,
            every=every,
            to=to,
            replace=replace,
            note=note,
            json=json,
        )
    )


@app.command()
def camera(
    views: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME=]VIEWS..", help="Folder, video or pattern ('views/left*.jpg') for each camera."),
    ] = None,
    corners: Corners = "",
    square_mm: SquareMm = 0.0,
    live: Annotated[bool, typer.Option("--live", help="Take the views from the rig's camera now.")] = False,
    rig: RigFile = None,
    camera: Annotated[str | None, typer.Option(help="Name of the camera in the rig's file.")] = None,
    count: Annotated[int, typer.Option("--views", help="Live views to keep.", min=4)] = 20,
    every: Every = 1,
    to: To = None,
    replace: Replace = False,
    note: Note = "",
    seed: Seed = 0,
    json: AsJson = False,
) -> None:
    """Find cameras' intrinsics and distortion from views of a checkerboard."""
    from rig.calibrate import camera as procedure
    from rig.config.loader import chosen_rig

    procedure.run(
        procedure.CameraCalibrationRequest(
            views=tuple(views or ()),
            corners=corners,
            square_mm=square_mm,
            live=live,
            rig=chosen_rig(rig).name if live else rig,
            camera=camera,
            count=count,
            every=every,
            to=to,
            replace=replace,
            note=note,
            seed=seed,
            json=json,
        )
    )


@app.command()
def tool(
    rig: RigName = None,
    camera: Annotated[str | None, typer.Option(help="Name of the camera in the rig's file.")] = None,
    straight: Annotated[Path | None, typer.Option(metavar="VIEWS", help="Views of the vented, straight arm.")] = None,
    turned: Annotated[
        Path | None, typer.Option(metavar="VIEWS", help="Views with the end cap turned about the arm's axis.")
    ] = None,
    live: Annotated[bool, typer.Option("--live", help="Take the views from the rig's camera now.")] = False,
    tip_std_mm: Annotated[
        float, typer.Option(help="Standard uncertainty of the straight arm's tip position [mm].")
    ] = 0.1,
    tip_std_deg: Annotated[
        float, typer.Option(help="Standard uncertainty of the straight arm's tip direction [deg].")
    ] = 0.2,
    to: To = None,
    replace: Replace = False,
    note: Note = "",
    seed: Seed = 0,
    json: AsJson = False,
) -> None:
    """Find the board's offset from the arm's central axis and its rotation."""
    from rig.calibrate import tool as procedure
    from rig.config.loader import chosen_rig

    procedure.run(
        procedure.ToolCalibrationRequest(
            rig=chosen_rig(rig).name,
            camera=camera,
            straight=straight,
            turned=turned,
            live=live,
            tip_std_mm=tip_std_mm,
            tip_std_deg=tip_std_deg,
            to=to,
            replace=replace,
            note=note,
            seed=seed,
            json=json,
        )
    )


@app.command()
def pressure(
    rig: RigName = None,
    readings: Annotated[
        Path | None, typer.Option(metavar="CSV", help="Existing readings: actuator,volts_V,gauge_bar.")
    ] = None,
    sensors: Annotated[bool, typer.Option(help="Scale the sensors against the gauge.")] = True,
    valves: Annotated[bool, typer.Option(help="Sweep the valves that meter flow.")] = True,
    fast: Fast = False,
    gauge: Annotated[str, typer.Option(help="Name and number of the gauge; stored in the file.")] = "",
    gauge_std_bar: Annotated[float, typer.Option(help="Standard uncertainty of the gauge [bar].")] = 0.002,
    volume_ml: Annotated[float | None, typer.Option(help="One chamber with its tube [ml]; default: the rig's.")] = None,
    volume_std_ml: Annotated[
        float | None, typer.Option(help="Standard uncertainty of that volume [ml]; default: a tenth.")
    ] = None,
    to: To = None,
    replace: Replace = False,
    note: Note = "",
    yes: Yes = False,
    seed: Seed = 0,
    json: AsJson = False,
) -> None:
    """Find the sensors' scales against a gauge, and the valves' dead zone and flow curve by a sweep."""
    from rig.calibrate import pressure as procedure
    from rig.config.loader import chosen_rig

    procedure.run(
        procedure.PressureCalibrationRequest(
            rig=chosen_rig(rig).name,
            readings=readings,
            sensors=sensors,
            valves=valves,
            fast=fast,
            gauge=gauge,
            gauge_std_bar=gauge_std_bar,
            volume_ml=volume_ml,
            volume_std_ml=volume_std_ml,
            to=to,
            replace=replace,
            note=note,
            yes=yes,
            seed=seed,
            json=json,
        )
    )
