"""Configuration of the page's process."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rig.live.authentication import AccessTokens

LINGER_S = 3.0
"""Time after the end of a run in which browsers can fetch the last packet."""


@dataclass(frozen=True)
class PageConfiguration:
    """Listening socket `fd` and the source: `run` is a control socket, `archive` a file; one of them is None."""

    fd: int
    tokens: AccessTokens
    run: Path | None = None
    archive: Path | None = None
