"""Commands that add notes and tags to a run afterwards."""

from __future__ import annotations

from typing import Annotated

import typer

from rig.cli.options import Archive


def note(archive: Archive, text: Annotated[str, typer.Argument(metavar="TEXT", help="The note, in quotes.")]) -> None:
    """Add a note to a run; the archive stays as it is."""
    from rig.cli.run_names import resolve
    from runs.annotations import add_note

    typer.echo(add_note(resolve(archive), text))


def tag(
    archive: Archive,
    tags: Annotated[list[str], typer.Argument(metavar="TAG..", help="One or several words, as bad.")],
    remove: Annotated[bool, typer.Option("--remove", help="Remove these tags.")] = False,
) -> None:
    """Add tags to a run, or remove them; the archive stays as it is."""
    from rig.cli.run_names import resolve
    from runs.annotations import add_tags, remove_tags

    typer.echo((remove_tags if remove else add_tags)(resolve(archive), tags))
