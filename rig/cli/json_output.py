"""JSON output of commands."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any

import typer


def print_json(facts: Any) -> None:
    """Print indented JSON; a dataclass becomes an object, NaN and infinity become null."""
    typer.echo(json.dumps(_plain(facts), indent=2))


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return _plain(dataclasses.asdict(value))
    if isinstance(value, dict):
        return {key: _plain(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
