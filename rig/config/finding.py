"""A finding of `rig doctor`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Finding:
    """One check: its result, and the remedy for a missing part."""

    topic: str
    verdict: Literal["ok", "missing", "note"]
    found: str
    remedy: str = ""
