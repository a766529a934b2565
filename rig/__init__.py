"""The running experiment: everything that touches hardware, time or the operator."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from rig.session.session import Session


def open(name: Path | str | None = None) -> Session:
    """Open a rig for runs from Python, by name or file; by default the rig that the command line would choose.

    Raises:
        BadInputError: every problem of the rig file.
    """
    from rig.session.session import Session

    return Session(None if name is None else str(name))
