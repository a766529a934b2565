"""`rig publish`: runs as a crate for a data repository."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rig.cli.options import Archives, OutputFile, Replace


def publish(
    archives: Archives,
    to: OutputFile = Path("crate.zip"),
    title: Annotated[str, typer.Option(help="Title; default: that of the run.", show_default=False)] = "",
    creator: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Creator, as 'Ada Lovelace 0000-0002-1825-0097'; may be repeated."),
    ] = None,
    licence: Annotated[str, typer.Option(metavar="SPDX", help="Licence of the data, as CC-BY-4.0.")] = "",
    elabftw: Annotated[
        str, typer.Option(metavar="URL", help="Also add the crate to this eLabFTW server, as a new experiment.")
    ] = "",
    replace: Replace = False,
) -> None:
    """Write runs as a crate (RO-Crate) for a data repository: metadata, checksums, licence, fields.

    --elabftw takes the key of the API from the environment variable ELABFTW_API_KEY.
    """
    from protocols.problems import bad_input
    from rig.cli.run_names import resolve
    from rig.publish.crate import remaining, write
    from rig.publish.description import describe
    from rig.publish.elabftw import Notebook, entry
    from runs.run import Run

    if to.suffix.lower() != ".zip":
        raise bad_input("--to", str(to), "a file whose name ends with .zip")
    runs = [Run(path) for path in dict.fromkeys(resolve(archive) for archive in archives)]
    if (names := [run.path.name for run in runs]) and len(set(names)) < len(names):
        raise bad_input("RUN", ", ".join(names), "archives of different file names")
    description = describe(runs, title, creator or (), licence)
    notebook = Notebook.of_environment(elabftw) if elabftw else None
    typer.echo(write(runs, description, to, replace=replace))
    for sentence in remaining(description):
        typer.echo(sentence, err=True)
    if notebook is not None:
        typer.echo(notebook.add(description.title, *entry(runs, description), to))
