"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON, for scripts.")]
RigName = Annotated[
    str | None,
    typer.Option(
        "--rig",
        metavar="NAME|FILE",
        help="Name or file of the rig. Default: $SOFTRIG_RIG, else ./softrig.yaml, else mock.",
    ),
]
VentedRig = Annotated[
    str | None,
    typer.Option(
        "--rig",
        metavar="NAME|FILE",
        help="Name or file of the rig. Default: $SOFTRIG_RIG, else ./softrig.yaml, else the running experiments.",
    ),
]
Variant = Annotated[
    str | None, typer.Option("--model", help="homogeneous, homogeneous+rpe or inhomogeneous+rpe; default: the rig's.")
]
Fast = Annotated[bool, typer.Option("--fast", help="Virtual time; simulated rigs only.")]
Seed = Annotated[int, typer.Option(help="Seed of the simulator.", min=0)]
Yes = Annotated[bool, typer.Option("--yes", help="Arm without asking.")]
Operator = Annotated[str, typer.Option(help="Name of the operator; stored in the archive.")]
Note = Annotated[str, typer.Option(help="A remark; stored in the output file.")]
_RUN = "Archive, run id or a unique part of one, or last: the newest run in data/."
Archive = Annotated[Path, typer.Argument(metavar="RUN", help=_RUN)]
Archives = Annotated[list[Path], typer.Argument(metavar="RUN..", help=_RUN)]
Parameters = Annotated[
    Path | None,
    typer.Option("--parameters", metavar="FILE", help="Identified parameters, to apply to the rig.", dir_okay=False),
]
Folder = Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder of the archives.", file_okay=False)]
Replace = Annotated[bool, typer.Option("--replace", help="Replace existing files.")]
Every = Annotated[int, typer.Option("--every", metavar="N", help="Use every Nth frame.", min=1)]
Free = Annotated[
    str,
    typer.Option(
        "--free",
        metavar="NAME,..",
        help="Parameters to estimate, separated by commas; docs/reference/parameters.md lists them.",
    ),
]
