"""Exact arithmetic with the decimal numbers of a YAML file: 0.15 to 0.65 by 0.05 is eleven levels, not ten."""

from __future__ import annotations

from decimal import Decimal

PA_PER_BAR = 100_000
"""An integer, as `Decimal` multiplies by no float."""

_ROUNDING = Decimal("1e-12")
"""Relative error, at most, of a quotient without end: 0.2 / 3 times 3 is 0.2."""
_NEAR = Decimal("0.001")
"""Part of a step by which the last level may be past the stop in the message about it."""


def pa(bar: float) -> float:
    """The float nearest to a pressure [Pa] that is written in bar: 0.55 bar is 55000 Pa, not 55000.00000000001."""
    return float(_exact(bar) * PA_PER_BAR)


def stair_count(start: float, stop: float, step: float) -> int:
    """Number of levels from start, at whole steps, up to stop, both included."""
    return round(abs(_exact(stop) - _exact(start)) / _exact(step)) + 1


def levels_bar(start: float, stop: float, step: float) -> tuple[float, ...]:
    """The levels of whole steps from start to stop, each the decimal number that a person would write."""
    first, span = _exact(start), _exact(stop) - _exact(start)
    steps = stair_count(start, stop, step) - 1
    return (start, *(float(first + span * i / steps) for i in range(1, steps + 1)))


def uneven_stairs(start: float, stop: float, step: float) -> tuple[str, str] | None:
    """Expectation and suggestion if whole steps do not lead from start to stop; None if they do."""
    first, last, size = _exact(start), _exact(stop), _exact(step)
    span = abs(last - first)
    if abs(span - round(span / size) * size) <= _ROUNDING * max(abs(first), abs(last)):
        return None
    whole = int(span / size + _NEAR)
    if whole == 0:
        return f"a step that fits between start_bar ({start:.12g}) and stop_bar ({stop:.12g})", f"{float(span):.12g}"
    reached = float(first + whole * (size if last > first else -size))
    expected = (
        f"whole steps from {start:.12g} to {stop:.12g} bar; by {step:.12g} the last level would be {reached:.12g}"
    )
    if (last - Decimal(repr(reached))) * (last - first) < 0:
        expected += ": round no digits off, or write the step as a quotient of a parameter, such as peak_bar / 3"
    return expected, f"stop_bar: {reached:.12g}"


def _exact(value: float) -> Decimal:
    return Decimal(repr(float(value)))
