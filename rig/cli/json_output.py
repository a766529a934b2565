"""Values as JSON can hold them."""

from __future__ import annotations

import math
from typing import Any


def plain_json(value: Any) -> Any:
    """Convert a value for JSON, with null for NaN and infinity."""
    if isinstance(value, dict):
        return {key: plain_json(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain_json(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
