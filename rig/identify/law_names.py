"""The laws of a comparison, by the names of `rig identify compare` and shorter ones."""

from __future__ import annotations

from collections.abc import Sequence

from calibration.identify.candidates import Candidate, candidates
from calibration.identify.setup import Setup
from model.variants import POINTWISE
from protocols import arguments
from protocols.problems import bad_input, closest

BASE = ("base",)
"""What is free in every law, beside its own parameters."""


def laws_named(names: Sequence[str], start: Setup, option: str, free: Sequence[str] = BASE) -> tuple[Candidate, ...]:
    """The two laws by name, from a setup. A variant alone means its pointwise law; rules and push laws need no variant.

    option: where the names come from, for the message.

    Raises:
        BadInputError: an unknown name, or not two different laws.
    """
    names = arguments.names(option, names)
    every = {law.name: law for law in candidates(start, free)}
    short = {name.rpartition(", ")[2]: name for name in every}
    short |= {name.removesuffix(f", {POINTWISE}"): name for name in every}
    found = []
    for name in names:
        full = name if name in every else short.get(name)
        if full is None:
            expected = "one of " + "; ".join(every)
            raise bad_input(option, name, expected, closest(name, {**every, **short}))
        found.append(every[full])
    if len({law.name for law in found}) != 2:
        raise bad_input(option, " ".join(names), "two different laws")
    return tuple(found)
