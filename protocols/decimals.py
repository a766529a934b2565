"""Exact arithmetic with the decimal numbers of a YAML file: 0.15 to 0.65 by 0.05 is eleven levels, not ten."""

from __future__ import annotations

from decimal import Decimal

PA_PER_BAR = 100_000


def pa(bar: float) -> float:
    """The float nearest to a pressure [Pa] that is written in bar: 0.55 bar is 55000 Pa, not 55000.00000000001."""
    return float(_exact(bar) * PA_PER_BAR)


def stair_count(start: float, stop: float, step: float) -> int:
    """Number of levels from start, at whole steps, up to stop, both included."""
    return int(abs(_exact(stop) - _exact(start)) / _exact(step)) + 1


def levels_bar(start: float, stop: float, step: float) -> tuple[float, ...]:
    """The levels from start to stop, each the decimal number that a person would write."""
    first, size = _exact(start), _exact(step)
    if stop < start:
        size = -size
    return tuple(float(first + i * size) for i in range(stair_count(start, stop, step)))


def uneven_stairs(start: float, stop: float, step: float) -> tuple[str, str] | None:
    """Expectation and suggestion if whole steps do not lead from start to stop; None if they do."""
    first, last, size = _exact(start), _exact(stop), _exact(step)
    whole = int(abs(last - first) / size)
    reached = first + whole * (size if last > first else -size)
    if reached == last:
        return None
    if whole == 0:
        return (
            f"a step that fits between start_bar ({start:g}) and stop_bar ({stop:g})",
            f"{float(abs(last - first)):g}",
        )
    expected = f"whole steps from {start:g} to {stop:g} bar; by {step:g} the last level would be {float(reached):g}"
    return expected, f"stop_bar: {float(reached):g}"


def _exact(value: float) -> Decimal:
    return Decimal(repr(float(value)))
