"""Warnings that repeat: the first is reported at once, those that follow together, with their number and times.

While a condition comes and goes, the time between two reports doubles from `REPEATED_S` to `LONGEST_S`, so that it
cannot fill the list of events. After `LONGEST_S` without it, the next one is reported at once again, as the first.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from runs.records import Event, Level

SHARE_TIME_CONSTANT_S = 1.0
"""Time constant of the share of affected rows."""
CLEARED = 0.2
"""A condition ends once its share falls below this part of its threshold (hysteresis)."""
REPEATED_S = 10.0
"""Shortest time between two reports of the same kind."""
LONGEST_S = 60.0
"""A condition that comes again and stays is reported after this time at the latest."""


@dataclass
class _Repetitions:
    """Occurrences that are not reported yet."""

    start_ns: int
    number: int = 0
    first_ns: int = 0
    last_ns: int = 0
    _reported_ns: int | None = None
    _wait_s: float = REPEATED_S

    def add(self, t_ns: int) -> None:
        """Take an occurrence into account."""
        if not self.number:
            self.first_ns = t_ns
            if self._reported_ns is not None and t_ns - max(self.last_ns, self._reported_ns) >= LONGEST_S * 1e9:
                self._reported_ns, self._wait_s = None, REPEATED_S
        self.number, self.last_ns = self.number + 1, t_ns

    def due(self, t_ns: int) -> bool:
        """Whether to report now."""
        return self.number > 0 and (self._reported_ns is None or t_ns - self._reported_ns >= self._wait_s * 1e9)

    def report(self, t_ns: int) -> str:
        """How often and when they occurred, as the end of a message; empty for one that is reported at once."""
        number, self.number = self.number, 0
        first, self._reported_ns = self._reported_ns is None, t_ns
        if first:
            return ""
        self._wait_s = min(2 * self._wait_s, LONGEST_S)
        from_s, to_s = ((ns - self.start_ns) * 1e-9 for ns in (self.first_ns, self.last_ns))
        return (
            f"; once more at {from_s:.1f} s" if number == 1 else f"; {number} times from {from_s:.1f} s to {to_s:.1f} s"
        )


class RepeatedWarning:
    """A warning of something that has no duration, or whose duration is in its message."""

    def __init__(self, source: str, start_ns: int) -> None:
        """Times in messages count from `start_ns`."""
        self._source, self._repetitions = source, _Repetitions(start_ns)
        self._message = ""

    def events(self, t_ns: int, message: str = "") -> Iterator[Event]:
        """Take an occurrence with its message, or none; report what is due."""
        if message:
            self._message = message
            self._repetitions.add(t_ns)
        if self._repetitions.due(t_ns):
            yield from self.rest(t_ns)

    def rest(self, t_ns: int) -> Iterator[Event]:
        """Report what has not been reported."""
        if self._repetitions.number:
            yield warning_event(t_ns, self._source, self._message + self._repetitions.report(t_ns))


class Losses(RepeatedWarning):
    """Losses that are counted: the message has the number since the last report."""

    def __init__(self, source: str, words: str, start_ns: int) -> None:
        super().__init__(source, start_ns)
        self._words, self._lost = words, 0

    def add(self, t_ns: int, number: int) -> Iterator[Event]:
        """Take the number of losses since the last call; report what is due."""
        self._lost += number
        yield from self.events(t_ns, f"{self._lost} {self._words}" if number else "")

    def rest(self, t_ns: int) -> Iterator[Event]:
        """Report what has not been reported."""
        yield from super().rest(t_ns)
        self._lost = 0


@dataclass
class Condition:
    """One condition with hysteresis; `above` is the share of affected rows that triggers a warning."""

    above: float
    source: str
    start_ns: int
    share: float = 0.0
    since_ns: int = 0
    active: bool = False
    _shown: bool = False
    _hidden_s: float = 0.0
    _warning: str = ""
    _recovery: str = ""
    _repetitions: _Repetitions = field(init=False)

    def __post_init__(self) -> None:
        self._repetitions = _Repetitions(self.start_ns)

    def events(self, t_ns: int, period_s: float, part: float, warning: str, recovery: str) -> Iterator[Event]:
        """Take one row, of which `part` (0 to 1) is affected; report when the condition begins and when it ends.

        `{share}` in `warning` is the share of affected rows.
        """
        if self.share < self.above * CLEARED:
            self.since_ns = t_ns
        self.share += (part - self.share) * min(1.0, period_s / SHARE_TIME_CONSTANT_S)
        active = self.share > self.above * (CLEARED if self.active else 1.0)
        yield from self.changed(t_ns, active, warning.replace("{share}", f"{self.share:.0%}"), recovery)

    def changed(self, t_ns: int, active: bool, warning: str, recovery: str) -> Iterator[Event]:
        """Take whether the condition holds, since `since_ns`; report when it begins and when it ends."""
        before, self.active = self.active, active
        if active and not before:
            self._repetitions.add(t_ns)
            self._warning, self._recovery = warning, recovery
        elif before and not active:
            if self._shown:
                self._shown = False
                lasted_s = (t_ns - self.since_ns) * 1e-9
                yield Event(t_ns, Level.INFO, self.source, f"{recovery}, after {lasted_s:.2f} s")
            else:
                self._hidden_s += (t_ns - self.since_ns) * 1e-9
        if self._repetitions.due(t_ns):
            yield from self.rest(t_ns)

    def rest(self, t_ns: int) -> Iterator[Event]:
        """Report what has not been reported."""
        if not self._repetitions.number:
            return
        message = self._warning + self._repetitions.report(t_ns)
        if self._hidden_s:
            message += f", for {self._hidden_s:.2f} s in all"
        self._hidden_s, self._shown = 0.0, self.active
        yield warning_event(t_ns, self.source, message if self.active else f"{message}; now {self._recovery}")


def warning_event(t_ns: int, source: str, message: str) -> Event:
    """The event of a warning about a condition that does not end the run."""
    return Event(t_ns, Level.WARNING, source, f"{message}; the run continues")
