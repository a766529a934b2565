"""Options that several commands share: one name, one meaning, one declaration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from rig.cli import completion
from rig.cli.run_options import of_run
from rig.hardware import running


def _rig(default: str) -> Any:
    """Declare --rig; `default` says which rig is used without it."""
    return typer.Option(
        "--rig",
        metavar="NAME|FILE",
        help="Name or file of the rig.",
        show_default=default,
        autocompletion=completion.rigs,
    )


RigName = Annotated[str | None, _rig("$SOFTRIG_RIG, else ./softrig.yaml, else mock")]
ExistingRig = Annotated[str | None, _rig("$SOFTRIG_RIG, else ./softrig.yaml, else none")]
VentedRig = Annotated[str | None, _rig("$SOFTRIG_RIG, else ./softrig.yaml, else none beside the running experiments")]
Everything = Annotated[bool, typer.Option(running.ALL, help="Also simulated experiments beside those on real devices.")]
RecordedRig = Annotated[str | None, _rig("the rig of the run")]
ViewedRig = Annotated[str | None, _rig("none; --capture: as for rig run")]

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON, for scripts.")]
Fast = Annotated[bool, of_run("fast")]
Seed = Annotated[int, of_run("seed")]
Yes = Annotated[bool, of_run("yes")]
Operator = Annotated[str, of_run("operator")]
Note = Annotated[str, of_run("note")]
Parameters = Annotated[Path | None, of_run("parameters")]
Variant = Annotated[str | None, of_run("model")]
Free = Annotated[str, of_run("free")]
Force = Annotated[bool, typer.Option("--force", help="Read a damaged archive as it is.")]
Replace = Annotated[bool, typer.Option("--replace", help="Replace existing files.")]

_RUN = "Archive, run id or a unique part of one, or last: the newest run in data/."
Archive = Annotated[Path, typer.Argument(metavar="RUN", help=_RUN, autocompletion=completion.runs)]
Archives = Annotated[list[Path], typer.Argument(metavar="RUN..", help=_RUN, autocompletion=completion.runs)]
ProtocolName = Annotated[
    str,
    typer.Argument(metavar="NAME|FILE", help="Named protocol, or a YAML file.", autocompletion=completion.protocols),
]

Folder = Annotated[Path, of_run("out")]
OptionalFolder = Annotated[Path | None, of_run("out", "beside the archive")]


def _file(default: str | bool) -> Any:
    """Declare --to; `default` says which file is written without it."""
    return typer.Option("--to", metavar="FILE", help="Output file.", show_default=default)


OutputFile = Annotated[Path, _file(True)]
DatedFile = Annotated[Path | None, _file("a dated name")]
BoardFile = Annotated[Path | None, _file("board-RIG.pdf")]
ParametersFile = Annotated[Path | None, _file("none; with --rig-file: beside it")]
DrawingFile = Annotated[Path | None, _file("no drawing")]
ReportFile = Annotated[Path | None, _file("beside the first archive")]

Format = Annotated[str, typer.Option("--format", help="Format of the output.")]

Calibrations = Annotated[
    list[Path] | None,
    typer.Option("--calibration", metavar="FILE", help="File of `rig calibrate` to apply; may be repeated."),
]
Scheduler = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="tcp://HOST:PORT", help="Dask scheduler for the work; default: all cores."),
]
Every = Annotated[int, typer.Option("--every", metavar="N", help="Use every Nth frame.", min=1)]

Corners = Annotated[
    str, typer.Option("--corners", help="Inner corners of a checkerboard, as 9x6; default: the board of --rig.")
]
SquareMm = Annotated[float, typer.Option("--square-mm", help="Edge of a square of that checkerboard [mm].")]
Camera = Annotated[str | None, typer.Option("--camera", help="Name of the camera in the rig file.")]
Capture = Annotated[bool, typer.Option("--capture", help="Capture the views with the rig's camera now.")]
