"""The one rule by which commands write over files: only with consent, or where they made the file for this purpose."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path


class WouldOverwrite(Exception):  # noqa: N818
    """A file that exists would be lost; the message names it and the option that allows that."""


def refuse_existing(
    files: Iterable[Path],
    *,
    replace: bool = False,
    option: str = "--replace",
    made: Callable[[Path], bool] = lambda _: False,
) -> None:
    """Refuse to write files that exist, before anything is computed.

    `replace` is the user's consent, which `option` gives. `made` tells of an existing file that the same command made it
    for the same purpose, so that it may be written again.

    Raises:
        WouldOverwrite: a file exists and may not be replaced, or is a folder.
    """
    for file in files:
        if file.is_dir():
            raise WouldOverwrite(f"{file} is a folder: name a file")
        # A broken link, too: what it points to would be made.
        if os.path.lexists(file) and not replace and not made(file):
            raise WouldOverwrite(f"{file} exists: name another file, or say {option} to write over it")
