"""The variants of the model, by name."""

from __future__ import annotations

from typing import get_args

from protocols import BadInputError, Problem
from protocols.problems import closest
from rig.config.sections import Variant

VARIANTS: tuple[Variant, ...] = get_args(Variant)


def variant_named(name: str | None) -> Variant | None:
    """Return the model variant of a name, None for None; raise `BadInputError` for an unknown one."""
    chosen = next((known for known in VARIANTS if known == name), None)
    if name is not None and chosen is None:
        expected = f"one of {', '.join(VARIANTS)}"
        raise BadInputError([Problem("--model", 0, 0, "", name, expected, closest(name, VARIANTS))])
    return chosen
