"""Whether the paper's tables are reproduced: a sentence about each whole table, not about its best number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rig.reproduce.comparison import ResultOrigin
from rig.reproduce.table4 import Space

AGREES = 0.05
"""Largest relative difference of a reproduced number."""
_NAMES = ("homogeneous", "homogeneous with RPE", "inhomogeneous with RPE")

Errors = Sequence[float | None]


def table3(printed: Sequence[float], computed: Sequence[float], origin: ResultOrigin) -> str:
    """Return whether the three errors [%] agree with the printed ones."""
    off = [value / paper - 1 for value, paper in zip(computed, printed, strict=True)]
    numbers = f"{_listed(computed)} % here ({origin}), {_listed(printed)} % printed"
    missed = [f"{name} by {100 * one:+.0f} %" for name, one in zip(_NAMES, off, strict=True) if abs(one) > AGREES]
    if not missed:
        return f"Table 3 agrees within {100 * AGREES:g} %: {numbers}"
    text = f"Table 3 is not reproduced: {numbers}; {', '.join(missed)}"
    if len(missed) < len(computed):
        text += ". The table counts as reproduced only if all values agree"
    if origin == "simulated":
        text += "; the simulated arm follows the inhomogeneous model, so its small error is no evidence for the model"
    return text


def table4(
    labels: Sequence[str],
    printed: Mapping[tuple[Space, int], Errors],
    computed: Mapping[tuple[Space, int], Errors],
    origin: ResultOrigin,
) -> str:
    """Return whether the methods rank as printed by their errors [mm], for each rule along the arm and its N."""
    parts = []
    for (space, steps), errors in computed.items():
        paper = _ranking(printed[space, steps])
        # What the paper calls unstable has no printed rank.
        ours = _ranking([e if p is not None else None for e, p in zip(errors, printed[space, steps], strict=True)])
        where = f"{space}, N = {steps}"
        if ours == paper:
            parts.append(f"{where}: the ranking of the paper holds")
        else:
            best = paper[0]
            parts.append(
                f"{where}: the ranking is contradicted: {labels[best]} is best in the paper and number "
                f"{ours.index(best) + 1} of {len(ours)} here, where {labels[ours[0]]} is best"
            )
    for space in dict.fromkeys(space for space, _ in computed):
        grids = sorted(steps for name, steps in computed if name == space)
        if len(grids) > 1:
            change = [_mean(table[space, grids[-1]]) - _mean(table[space, grids[0]]) for table in (printed, computed)]
            same = "agrees" if abs(change[1] - change[0]) <= 0.5 * abs(change[0]) else "does not agree"
            parts.append(
                f"{space}: the change from N = {grids[0]} to {grids[-1]} {same}: {change[1]:+.3f} mm here, "
                f"{change[0]:+.3f} mm printed"
            )
    return f"Table 4, errors ({origin}): " + "; ".join(parts)


def _listed(values: Sequence[float]) -> str:
    return " / ".join(f"{value:.2f}" for value in values)


def _ranking(errors: Errors) -> list[int]:
    """Indices of the methods, the smallest error first; without those that have none."""
    return [index for _, index in sorted((error, index) for index, error in enumerate(errors) if error is not None)]


def _mean(errors: Errors) -> float:
    """The mean of the five methods that the paper calls stable; the first ones."""
    stable = [error for error in errors[:5] if error is not None]
    return sum(stable) / len(stable)
