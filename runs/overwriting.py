"""The one rule by which commands write over files: only with consent, or where they made the file for this purpose."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

Made = Callable[[Path], bool]
"""Tells of an existing file whether the same command made it for the same purpose: then it may be written again."""


class WouldOverwriteError(FileExistsError):
    """A file that exists would be lost; the message names it and the option that allows that."""


def refuse_existing(
    files: Iterable[Path],
    *,
    replace: bool = False,
    option: str = "--replace",
    made: Made = lambda _: False,
) -> None:
    """Refuse to write files that exist, before anything is computed.

    `replace` is the user's consent, which `option` gives.

    Raises:
        WouldOverwriteError: a file exists and may not be replaced, or is a folder.
    """
    for file in files:
        if file.is_dir():
            raise WouldOverwriteError(f"{file} is a folder: name a file")
        # A broken link, too: what it points to would be made.
        if os.path.lexists(file) and not replace and not made(file):
            raise WouldOverwriteError(f"{file} exists: name another file, or say {option} to write over it")


@contextmanager
def staged(folder: Path, *, replace: bool = False, made: Made = lambda _: False) -> Iterator[Path]:
    """A temporary folder whose files move to `folder` at the end; none does where one may not be replaced.

    Raises:
        WouldOverwriteError: as `refuse_existing`.
        OSError: the folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder, prefix=".writing-") as name:
        stage = Path(name)
        yield stage
        moves = {file: folder / file.relative_to(stage) for file in sorted(stage.rglob("*")) if file.is_file()}
        refuse_existing(moves.values(), replace=replace, made=made)
        for file, target in moves.items():
            target.parent.mkdir(exist_ok=True)
            file.replace(target)
