"""Overwrite rule of all commands: only with consent, or a file that the same command made for the same purpose."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

Made = Callable[[Path], bool]
"""Whether an existing file was made by the same command for the same purpose, so that it may be overwritten."""


class WouldOverwriteError(FileExistsError):
    """A file exists; the message names it and the option that allows overwriting."""


def refuse_existing(files: Iterable[Path], *, replace: bool = False, made: Made = lambda _: False) -> None:
    """Refuse to overwrite files without the user's consent, before any computation.

    Raises:
        WouldOverwriteError: a file exists and may not be replaced, is a folder, or lies below something that is none.
    """
    for file in files:
        above = next(filter(os.path.lexists, file.parents), None)
        if above is not None and not above.is_dir():
            raise WouldOverwriteError(f"{file}: {above} is not a folder: name another one")
        if file.is_dir():
            raise WouldOverwriteError(f"{file} is a folder: name a file")
        # Also a broken link: writing would create its target.
        if os.path.lexists(file) and not replace and not made(file):
            raise WouldOverwriteError(f"{file} exists: name another file, or say --replace to write over it")


@contextmanager
def naming(file: Path) -> Iterator[None]:
    """Give an `OSError` without a path, such as that of a full disk, the path of the file that is written."""
    try:
        yield
    except OSError as error:
        if error.errno is not None and error.filename is None:
            error.filename = str(file)
        raise


def write_text(file: Path, text: str) -> None:
    """Write a file as a whole: under another name first, so that no half of it takes its place.

    Raises:
        OSError: it cannot be written.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_name(f".{file.name}.part")
    try:
        with naming(file):
            part.write_text(text, encoding="utf-8")
        part.replace(file)
    except OSError:
        part.unlink(missing_ok=True)
        raise


@contextmanager
def staged(folder: Path, *, replace: bool = False, made: Made = lambda _: False) -> Iterator[Path]:
    """A temporary folder whose files move to `folder` at the end; none moves if one may not be replaced.

    Raises:
        WouldOverwriteError: as `refuse_existing`.
        OSError: the folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder, prefix=".writing-") as name:
        stage = Path(name)
        with naming(folder):
            yield stage
        moves = {file: folder / file.relative_to(stage) for file in sorted(stage.rglob("*")) if file.is_file()}
        refuse_existing(moves.values(), replace=replace, made=made)
        for file, target in moves.items():
            target.parent.mkdir(exist_ok=True)
            file.replace(target)
