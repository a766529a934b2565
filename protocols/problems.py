"""Problems of user input, with place, value and remedy."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass

SHOWN = 40


@dataclass(frozen=True)
class Problem:
    """One problem: the place (`line`, `column` from 1; 0 for the whole file), the value, and the remedy."""

    file: str
    line: int
    column: int
    where: str
    value: str
    expected: str
    suggestion: str = ""

    @property
    def place(self) -> tuple[str, int, int]:
        """File, line and column."""
        return self.file, self.line, self.column

    def __str__(self) -> str:
        place = self.file
        if self.line:
            place += f":{self.line}"
            if self.column:
                place += f":{self.column}"
        head = ": ".join(part for part in (place, self.where) if part)
        lines = [head]
        if self.value:
            lines.append(f"  found     {self.value}")
        lines.append(f"  expected  {self.expected}" if self.value else f"  {self.expected}")
        if self.suggestion:
            lines.append(f"  did you mean {self.suggestion}?")
        return "\n".join(lines)


class BadInputError(Exception):
    """Invalid user input; `problems` has every problem and `str()` is the full message."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__(self.problems)

    def __str__(self) -> str:
        blocks = [str(problem) for problem in self.problems[:SHOWN]]
        if len(self.problems) > SHOWN:
            blocks.append(f"and {len(self.problems) - SHOWN} more problems")
        return "\n".join(blocks)


def bad_input(place: str, value: str, expected: str, suggestion: str = "") -> BadInputError:
    """The error of one problem with a whole file, or with an option of a command."""
    return BadInputError([Problem(place, 0, 0, "", value, expected, suggestion)])


def raise_all(problems: Iterable[Problem]) -> None:
    """Raise all problems; do nothing if there are none."""
    if listed := tuple(problems):
        raise BadInputError(listed)


def closest(word: str, known: Iterable[str]) -> str:
    """The known word closest to `word`, or an empty string."""
    by_folded = {_folded(name): name for name in known}
    folded = _folded(word)
    if folded in by_folded:
        return by_folded[folded]
    starts = [name for key, name in by_folded.items() if len(folded) > 1 and key.startswith(folded)]
    if len(starts) == 1:
        return starts[0]
    match = difflib.get_close_matches(folded, by_folded, n=1, cutoff=0.7)
    return by_folded[match[0]] if match else ""


def _folded(word: str) -> str:
    return word.casefold().replace("-", "_").replace(" ", "_")
