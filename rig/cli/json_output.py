"""JSON output of commands."""

from __future__ import annotations

import json
import math
from typing import Any


def to_json(facts: Any) -> str:
    """Return indented JSON, with null for NaN and infinity."""
    return json.dumps(_finite(facts), indent=2)


def _finite(value: Any) -> Any:
    """Convert a value for JSON, with null for NaN and infinity."""
    if isinstance(value, dict):
        return {key: _finite(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
