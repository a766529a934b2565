"""The variants of the model, by name."""

from __future__ import annotations

from model.variants import VARIANTS
from protocols.arguments import shown
from protocols.problems import bad_input, closest
from rig.config.sections import Variant


def variant_named(name: str | None) -> Variant | None:
    """Return the model variant of a name, None for None; raise `BadInputError` for an unknown one."""
    if name is not None and not (isinstance(name, str) and name in VARIANTS):
        expected = f"one of {', '.join(VARIANTS)}"
        raise bad_input("--model", shown(name), expected, closest(str(name), VARIANTS))
    return name
