"""Checks of arguments from Python, whose types the command line or a YAML file would have checked."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from numbers import Integral, Real
from pathlib import Path
from typing import TypeVar

from protocols.problems import Problem, bad_input, raise_all
from protocols.source_positions import shortened

T = TypeVar("T")
LARGEST = 2**63 - 1
TEXT = "text without NUL and lone surrogates"


def number(value: object) -> float | None:
    """The number as a float; infinity for a larger one, None for what is no number. True and False are none."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return None
    try:
        return float(value)
    except OverflowError:
        return math.inf


def finite(value: object) -> float | None:
    """The number as a float; None for what is no finite number."""
    found = number(value)
    return found if found is not None and math.isfinite(found) else None


def settings(given: object) -> dict[str, float]:
    """The values of a protocol's parameters as floats; none for None; or `BadInputError`."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise bad_input("--set", shown(given), "a mapping from names of parameters to numbers")
    numbers = {name: number(value) for name, value in given.items()}
    raise_all(
        Problem("--set", 0, 0, "", f"{shown(name)}={shown(given[name])}", "the name of a parameter, and a number")
        for name, value in numbers.items()
        if value is None or not isinstance(name, str)
    )
    return {name: value for name, value in numbers.items() if value is not None}


def of_type(option: str, value: object, kind: type[T], expected: str) -> T:
    """The value, which is of that type; or `BadInputError`."""
    if isinstance(value, kind):
        return value
    raise bad_input(option, shown(value), expected)


def storable(value: object) -> bool:
    """True for text that journal and archive keep as it is."""
    return isinstance(value, str) and "\0" not in value and not any("\ud800" <= sign <= "\udfff" for sign in value)


def shown(value: object) -> str:
    """A value of any type in a message: text as it is if it can be printed, the rest as Python writes it."""
    return shortened(value if isinstance(value, str) and value.isprintable() and value else repr(value))


def text_problems(texts: Mapping[str, object]) -> list[Problem]:
    """A problem for each value that cannot be stored as text; the keys name the options."""
    return [Problem(option, 0, 0, "", shown(text), TEXT) for option, text in texts.items() if not storable(text)]


def whole_number_problems(option: str, value: object, lowest: int) -> list[Problem]:
    """The problem of a value that is not an integer of at least `lowest` and of 64 bits, if it is none."""
    found = int(value) if isinstance(value, Integral) and not isinstance(value, bool) else None
    if found is not None and lowest <= found <= LARGEST:
        return []
    limits = f"from {lowest} to {LARGEST}" if found is not None and found > LARGEST else f"of at least {lowest}"
    return [Problem(option, 0, 0, "", shown(value), f"an integer {limits}")]


def flag_problems(flags: Mapping[str, object]) -> list[Problem]:
    """A problem for each value that is neither True nor False; the keys name the options."""
    return [
        Problem(option, 0, 0, "", shown(flag), "True or False")
        for option, flag in flags.items()
        if not isinstance(flag, bool)
    ]


def names(option: str, value: object) -> tuple[str, ...]:
    """The names in a list; or `BadInputError`."""
    listed = tuple(value) if isinstance(value, Iterable) and not isinstance(value, str | bytes) else (None,)
    if all(isinstance(name, str) for name in listed):
        return listed
    raise bad_input(option, shown(value), "a list of names")


def path(option: str, value: object) -> Path:
    """The path that a value is; or `BadInputError`."""
    if isinstance(value, str | Path) and str(value) and "\0" not in str(value):
        with suppress(UnicodeEncodeError):
            os.fsencode(value)
            return Path(value)
    raise bad_input(option, shown(value), "a path")


def folder(option: str, value: object) -> Path:
    """The folder that a value names, in which one can write, and which is made later if it does not exist.

    Raises:
        BadInputError: it cannot be one.
    """
    wanted = path(option, value)
    try:
        nearest = next(place for place in (wanted, *wanted.absolute().parents) if place.exists())
    except OSError as error:
        raise bad_input(option, shown(str(wanted)), f"a folder: {error.strerror}") from None
    if not nearest.is_dir():
        raise bad_input(option, shown(str(wanted)), f"a folder; {nearest} is a file")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise bad_input(option, shown(str(wanted)), f"a folder in which you may write; {nearest} is not one")
    return wanted
