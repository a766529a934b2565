"""Checks of arguments from Python, whose types the command line would have checked."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from numbers import Real
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")
_MOST_SHOWN = 80


class ArgumentError(ValueError):
    """An argument is not what the function takes; the message has its name, its value and what is expected."""


def refused(name: str, value: object, expected: str) -> ArgumentError:
    """Return the error of an argument."""
    shown = repr(value)
    if len(shown) > _MOST_SHOWN:
        shown = f"{shown[:_MOST_SHOWN]}.."
    return ArgumentError(f"{name} {shown}: expected {expected}")


def path(name: str, value: object, expected: str = "a path") -> Path:
    """Return the path that a value is."""
    if isinstance(value, str | Path) and "\0" not in str(value):
        return Path(value)
    raise refused(name, value, expected)


def texts(given: Mapping[str, object]) -> None:
    """Check that each value, by its name, is text."""
    for name, value in given.items():
        if not isinstance(value, str):
            raise refused(name, value, "a text")


def number(name: str, value: object, expected: str) -> float:
    """Return the number that a value is."""
    if isinstance(value, Real) and not isinstance(value, bool):
        return float(value)
    raise refused(name, value, expected)


def items(name: str, value: object, kind: type[T], expected: str) -> list[T]:
    """Return what a value lists, all of one type."""
    listed = [*value] if isinstance(value, Iterable) and not isinstance(value, str | bytes | Mapping) else None
    if listed is None:
        raise refused(name, value, expected)
    for item in listed:
        if not isinstance(item, kind):
            raise refused(name, item, expected)
    return listed
