"""Options that several commands share: one name, one meaning, one declaration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from rig.cli import completion
from rig.config.tip_controllers import KNOWN
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
Fast = Annotated[bool, typer.Option("--fast", help="Virtual time; simulated rigs only.")]
Seed = Annotated[int, typer.Option("--seed", help="Seed of the random numbers.", min=0)]
Yes = Annotated[bool, typer.Option("--yes", help="Arm without asking.")]
Operator = Annotated[str, typer.Option("--operator", help="Name of the operator; stored in the archive.")]
Note = Annotated[str, typer.Option("--note", help="A remark; stored in the output file.")]
Metadata = Annotated[
    list[str] | None,
    typer.Option("--meta", metavar="NAME=VALUE", help="Metadata of the run, as specimen=A7; may be repeated."),
]
Force = Annotated[bool, typer.Option("--force", help="Read a damaged archive as it is.")]
Replace = Annotated[bool, typer.Option("--replace", help="Replace existing files.")]

_RUN = "Archive, run id or a unique part of one, or last: the newest run in data/."
Archive = Annotated[Path, typer.Argument(metavar="RUN", help=_RUN, autocompletion=completion.runs)]
Archives = Annotated[list[Path], typer.Argument(metavar="RUN..", help=_RUN, autocompletion=completion.runs)]
ProtocolName = Annotated[
    str,
    typer.Argument(metavar="NAME|FILE", help="Named protocol, or a YAML file.", autocompletion=completion.protocols),
]

Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="Value of a parameter of the protocol; may be repeated."),
]


def _folder(default: str | bool) -> Any:
    """Declare --out; `default` says which folder is used without it."""
    help_ = "Folder for the output files."
    return typer.Option("--out", metavar="DIR", help=help_, file_okay=False, show_default=default)


Folder = Annotated[Path, _folder(True)]
OptionalFolder = Annotated[Path | None, _folder("beside the archive")]


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

Variant = Annotated[
    str | None,
    typer.Option(
        "--model", help="Variant of the model, such as homogeneous+rpe.", show_default="the variant of the rig"
    ),
]
Controller = Annotated[
    str | None,
    typer.Option(
        "--controller",
        metavar="NAME",
        help=f"Tip controller: {KNOWN} or package:Class.",
        show_default="tip_control of the rig",
    ),
]
LearnFrom = Annotated[
    list[Path] | None,
    typer.Option(
        "--learn-from",
        metavar="RUN",
        help="Earlier run of the same protocol and rig, from which the tip controller learns; may be repeated.",
        autocompletion=completion.runs,
    ),
]
Parameters = Annotated[
    Path | None,
    typer.Option("--parameters", metavar="FILE", help="Identified parameters, to apply to the rig.", dir_okay=False),
]
Calibrations = Annotated[
    list[Path] | None,
    typer.Option("--calibration", metavar="FILE", help="File of `rig calibrate` to apply; may be repeated."),
]
Free = Annotated[
    str,
    typer.Option(
        "--free",
        metavar="NAME,..",
        help="Parameters to estimate, separated by commas. Groups: law, base, base_translation, base_rotation, tool, "
        "tool_rotation, gravity, actuator_angles, sensor_gains, sensor_offsets, branch_moduli, branch_times, "
        "stop_weights, stop_widths. Single ones: youngs_modulus_pa, a1_per_n, a2_per_n2, rpe_per_bar, shear_ratio, "
        "density_kg_m3, damping_s, branch_1_modulus, branch_1_time_s, stop_1_weight, stop_1_width_pa, "
        "push_growth_per_bar, cap_mass_kg, length_m, inner_radius_m, outer_radius_m, circle_radius_m, sensor_lag_s, "
        "sensor_filter_s; base_x_m and so on, base_rx_rad, tool_x_m, tool_rx_rad, gravity_rx_rad, "
        "actuator_1_turn_rad, sensor_1_gain, sensor_1_offset_pa.",
    ),
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
