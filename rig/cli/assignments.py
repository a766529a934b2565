"""Options whose text has a form: NAME,.. and NAME=VALUE."""

from __future__ import annotations

import math
from collections.abc import Sequence

from protocols.problems import Problem, raise_all


def names(given: str) -> list[str]:
    """The names of an option that are separated by commas."""
    return [name.strip() for name in given.split(",") if name.strip()]


def texts(option: str, given: Sequence[str] | None) -> dict[str, str]:
    """The values of an option by their names.

    Raises:
        BadInputError: all that are not of this form, or that name something twice.
    """
    found: dict[str, str] = {}
    problems = []
    for item in given or ():
        name, equals, value = (part.strip() for part in item.partition("="))
        if not (name and equals and value):
            problems.append(Problem(option, 0, 0, "", item or "''", "NAME=VALUE"))
        elif name in found:
            problems.append(Problem(option, 0, 0, "", item, f"each name once; there is {name}={found[name]} already"))
        else:
            found[name] = value
    raise_all(problems)
    return found


def numbers(option: str, given: Sequence[str] | None) -> dict[str, float]:
    """The same for values that are numbers."""
    found: dict[str, float] = {}
    problems = []
    for name, value in texts(option, given).items():
        try:
            found[name] = float(value)
        except ValueError:
            found[name] = math.nan
        if not math.isfinite(found[name]) or "_" in value:
            problems.append(Problem(option, 0, 0, "", f"{name}={value}", "a number after the =, in decimal notation"))
    raise_all(problems)
    return found
