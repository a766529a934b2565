"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON, for scripts.")]
Archive = Annotated[Path, typer.Argument(metavar="RUN", help="Archive, or its run id in the data folder.")]
Archives = Annotated[list[Path], typer.Argument(metavar="RUN..", help="Archives, or run ids in the data folder.")]
Parameters = Annotated[
    Path | None,
    typer.Option("--parameters", metavar="FILE", help="Identified parameters, to lay over the rig.", dir_okay=False),
]
Folder = Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder of the archives.", file_okay=False)]
