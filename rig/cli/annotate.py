"""Commands that add notes and tags to a run afterwards."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rig.cli.options import Archive


def _opened(archive: Path) -> Path:
    """The path of a run's archive, which is readable.

    Raises:
        BadInputError, ArchiveError: there is no such run, or it is no archive.
    """
    from rig.cli.run_names import resolve
    from runs.run import Run

    return Run(resolve(archive)).path


def note(archive: Archive, text: Annotated[str, typer.Argument(metavar="TEXT", help="The note, in quotes.")]) -> None:
    """Add a note to a run; the archive stays as it is."""
    from protocols.problems import bad_input
    from runs.annotation_file import add_note, path_of

    if not text.strip():
        raise bad_input("TEXT", repr(text), "a note, which is not empty")
    found = _opened(archive)
    add_note(found, text.strip())
    typer.echo(path_of(found))


def tag(
    archive: Archive,
    tags: Annotated[list[str], typer.Argument(metavar="TAG..", help="One or several words, as bad.")],
    remove: Annotated[bool, typer.Option("--remove", help="Remove these tags.")] = False,
) -> None:
    """Add tags to a run, or remove them; the archive stays as it is."""
    from protocols.problems import Problem, closest, raise_all
    from runs.annotation_file import TAG, add_tag, path_of, read, remove_tag

    words = "a word of at most 40 letters, digits, '_', '.' and '-'"
    problems = [Problem("TAG", 0, 0, "", name or "''", words) for name in tags if not TAG.fullmatch(name)]
    raise_all(problems)
    found = _opened(archive)
    present = read(found).tags
    if remove:
        expected = f"a tag of this run: {', '.join(present)}" if present else "a tag of this run; it has none"
        problems = [
            Problem("TAG", 0, 0, "", name, expected, closest(name, present)) for name in tags if name not in present
        ]
        raise_all(problems)
    for name in dict.fromkeys(tags):
        if remove:
            remove_tag(found, name)
        elif name not in present:
            add_tag(found, name)
    typer.echo(path_of(found))
