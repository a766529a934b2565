"""What the page's process is told when it starts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rig.live.authentication import AccessTokens

LINGER_S = 3.0
"""What browsers get after the end of a run to fetch the last packet."""


@dataclass(frozen=True)
class PageConfiguration:
    """What to show on which listening socket. `run` is the door of a run, `archive` a file; one of them is None."""

    fd: int
    tokens: AccessTokens
    run: Path | None = None
    archive: Path | None = None
