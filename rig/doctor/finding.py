"""What `rig doctor` says of one thing that it looked at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Finding:
    """One thing looked at: what was found, and the remedy where something is missing."""

    topic: str
    verdict: Literal["ok", "missing", "note"]
    found: str
    remedy: str = ""
