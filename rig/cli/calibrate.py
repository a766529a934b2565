"""`rig calibrate`: commands for cameras, DLT, tool and pressures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rig.cli import options
from rig.cli.commands import HelpGroup

app = typer.Typer(
    cls=HelpGroup,
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Calibrate cameras, DLT, tool and pressures; each writes a dated file.",
)


@app.command()
def dlt(
    given: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="CSV|NAME=VIEWS..", help="Control points, or each camera's simultaneous views of a board."
        ),
    ] = None,
    corners: options.Corners = "",
    square_mm: options.SquareMm = 0.0,
    calibration: options.Calibrations = None,
    rig: options.ViewedRig = None,
    size: Annotated[str, typer.Option(help="Size of the pictures, as 640x480, if no other option gives it.")] = "",
    points_std_mm: Annotated[
        float, typer.Option(help="Standard uncertainty of the control points, for the bundle adjustment.")
    ] = 0.0,
    world_view: Annotated[str, typer.Option(help="View whose board defines the world frame.")] = "",
    base: Annotated[
        str,
        typer.Option(
            metavar="X,Y,Z,A,B,C", help="Pose of that board in the rod-base frame: mm, rotation vector in deg."
        ),
    ] = "",
    every: options.Every = 1,
    to: options.DatedFile = None,
    replace: options.Replace = False,
    note: options.Note = "",
    json: options.AsJson = False,
) -> None:
    """Find cameras' 11 DLT coefficients and poses, from control points or from views of a board."""
    from rig.calibrate import dlt as procedure
    from rig.calibrate.file_sections import OutputFile
    from rig.cli import calibration_output

    done = procedure.run(
        procedure.DLTCalibrationRequest(
            given=tuple(given or ()),
            corners=corners,
            square_mm=square_mm,
            calibrations=tuple(calibration or ()),
            rig=rig,
            size=size,
            points_std_mm=points_std_mm,
            world_view=world_view,
            base=base,
            every=every,
            output=OutputFile(to, replace, note),
        )
    )
    calibration_output.dlt(done, as_json=json)


@app.command()
def camera(
    views: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME=]VIEWS..", help="Folder, video or pattern ('views/left*.jpg') for each camera."),
    ] = None,
    corners: options.Corners = "",
    square_mm: options.SquareMm = 0.0,
    capture: options.Capture = False,
    rig: options.ViewedRig = None,
    camera: options.Camera = None,
    count: Annotated[int, typer.Option(metavar="N", help="Views to capture.", min=4)] = 20,
    every: options.Every = 1,
    to: options.DatedFile = None,
    replace: options.Replace = False,
    note: options.Note = "",
    seed: options.Seed = 0,
    json: options.AsJson = False,
) -> None:
    """Find cameras' intrinsics and distortion from views of a board."""
    from rig.calibrate import camera as procedure
    from rig.calibrate.file_sections import OutputFile
    from rig.cli import calibration_output
    from rig.config.loader import chosen_rig

    done = procedure.run(
        procedure.CameraCalibrationRequest(
            views=tuple(views or ()),
            corners=corners,
            square_mm=square_mm,
            capture=capture,
            rig=chosen_rig(rig).name if capture else rig,
            camera=camera,
            count=count,
            every=every,
            seed=seed,
            output=OutputFile(to, replace, note),
        ),
        calibration_output.TerminalOperator(),
    )
    calibration_output.cameras(done, of_a_rig=capture or rig is not None, as_json=json)


@app.command()
def tool(
    rig: options.RigName = None,
    camera: options.Camera = None,
    straight: Annotated[Path | None, typer.Option(metavar="VIEWS", help="Views of the vented, straight arm.")] = None,
    turned: Annotated[
        Path | None, typer.Option(metavar="VIEWS", help="Views with the end cap turned about the arm's axis.")
    ] = None,
    capture: options.Capture = False,
    tip_std_mm: Annotated[
        float, typer.Option(help="Standard uncertainty of the straight arm's tip position [mm].")
    ] = 0.1,
    tip_std_deg: Annotated[
        float, typer.Option(help="Standard uncertainty of the straight arm's tip direction [deg].")
    ] = 0.2,
    to: options.DatedFile = None,
    replace: options.Replace = False,
    note: options.Note = "",
    seed: options.Seed = 0,
    json: options.AsJson = False,
) -> None:
    """Find the board's offset from the arm's central axis and its rotation."""
    from rig.calibrate import tool as procedure
    from rig.calibrate.file_sections import OutputFile
    from rig.cli import calibration_output
    from rig.config.loader import chosen_rig

    done = procedure.run(
        procedure.ToolCalibrationRequest(
            rig=chosen_rig(rig).name,
            camera=camera,
            straight=straight,
            turned=turned,
            capture=capture,
            tip_std_mm=tip_std_mm,
            tip_std_deg=tip_std_deg,
            seed=seed,
            output=OutputFile(to, replace, note),
        ),
        calibration_output.TerminalOperator(),
    )
    calibration_output.tool(done, as_json=json)


@app.command()
def pressure(
    rig: options.RigName = None,
    readings: Annotated[
        Path | None, typer.Option(metavar="CSV", help="Existing readings: actuator,volts_V,gauge_bar.")
    ] = None,
    sensors: Annotated[bool, typer.Option(help="Scale the sensors against the gauge.")] = True,
    valves: Annotated[bool, typer.Option(help="Sweep the valves that meter flow.")] = True,
    fast: options.Fast = False,
    gauge: Annotated[str, typer.Option(help="Name and number of the gauge; stored in the file.")] = "",
    gauge_std_bar: Annotated[float, typer.Option(help="Standard uncertainty of the gauge [bar].")] = 0.002,
    volume_ml: Annotated[
        float | None, typer.Option(help="Volume of one chamber with its tube [ml].", show_default="the rig's")
    ] = None,
    volume_std_ml: Annotated[
        float | None,
        typer.Option(help="Standard uncertainty of that volume [ml].", show_default="a tenth of the volume"),
    ] = None,
    to: options.DatedFile = None,
    replace: options.Replace = False,
    note: options.Note = "",
    yes: options.Yes = False,
    seed: options.Seed = 0,
    json: options.AsJson = False,
) -> None:
    """Find the sensors' scales against a gauge, and the valves' dead zone and flow curve by a sweep."""
    from rig.calibrate import pressure as procedure
    from rig.calibrate.file_sections import OutputFile
    from rig.cli import calibration_output
    from rig.config.loader import chosen_rig

    done = procedure.run(
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
            yes=yes,
            seed=seed,
            output=OutputFile(to, replace, note),
        ),
        calibration_output.TerminalOperator(),
    )
    calibration_output.pressure(done, as_json=json)
