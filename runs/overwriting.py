"""Overwrite rule of all commands: only with consent, or a file that the same command made for the same purpose."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
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
def naming(file: Path, part: Path | None = None) -> Iterator[None]:
    """Let an `OSError` name the file that is written, or one in this folder.

    The error of a full disk has no path; others have that of the temporary file or folder `part`.
    """
    try:
        yield
    except OSError as error:
        name = Path(file if error.filename is None else error.filename)
        if part is not None and name.is_relative_to(part):
            name = file / name.relative_to(part)
        if error.errno is not None:
            error.filename, error.filename2 = str(name), None
        raise


@contextmanager
def replacing(file: Path) -> Iterator[Path]:
    """A temporary path; the file that is written there takes the place of `file` at the end, and no half of it does.

    Raises:
        OSError: it cannot be written; the error names `file`.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    # A name that nobody knows: another user of the folder cannot have put a link there.
    part = file.with_name(f".{file.name}.{secrets.token_hex(8)}.part")
    try:
        with naming(file, part):
            yield part
            part.replace(file)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def write_text(file: Path, text: str) -> None:
    """Write a text file as a whole.

    Raises:
        OSError: it cannot be written; the error names `file`.
    """
    with replacing(file) as part:
        part.write_text(text, encoding="utf-8")


@contextmanager
def staged(folder: Path, *, replace: bool = False, made: Made = lambda _: False) -> Iterator[Path]:
    """A temporary folder whose files move to `folder` at the end; none moves if one may not be replaced.

    Raises:
        WouldOverwriteError: as `refuse_existing`.
        OSError: the folder cannot be written; the error names it, or a file in it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    stage = folder / f".writing-{secrets.token_hex(8)}"
    with naming(folder, stage):
        stage.mkdir()
    try:
        with naming(folder, stage):
            yield stage
            moves = {file: folder / file.relative_to(stage) for file in sorted(stage.rglob("*")) if file.is_file()}
            refuse_existing(moves.values(), replace=replace, made=made)
            for file, target in moves.items():
                target.parent.mkdir(exist_ok=True)
                file.replace(target)
    finally:
        shutil.rmtree(stage, ignore_errors=True)
