"""Warnings that repeat: the first is reported at once, those that follow together, with their number and times.

While a condition comes and goes, the time between two reports doubles from `REPEATED_S` to `LONGEST_S`, so that it
cannot fill the list of events. After `LONGEST_S` without it, the next one is reported at once again, as the first.
"""

from __future__ import annotations

from collections.abc import Iterator

from runs.records import Event, Level

SHARE_TIME_CONSTANT_S = 1.0
"""Time constant of the share of affected rows."""
CLEARED = 0.2
"""A condition ends once its share falls below this part of its threshold (hysteresis)."""
REPEATED_S = 10.0
"""Shortest time between two reports of the same kind."""
LONGEST_S = 60.0
"""A condition that comes again and stays is reported after this time at the latest."""


class RepeatedWarning:
    """A warning of something that has no duration, or whose duration is in its message."""

    def __init__(self, source: str, start_ns: int) -> None:
        """Times in messages count from `start_ns`."""
        self.source, self._start_ns = source, start_ns
        self._message = ""
        self._number = self._first_ns = self._last_ns = 0
        """Occurrences that are not reported yet, and times of the first and the last."""
        self._reported_ns: int | None = None
        self._wait_s = REPEATED_S

    def events(self, t_ns: int, message: str = "") -> Iterator[Event]:
        """Take an occurrence with its message, or none; report what is due."""
        if message:
            if not self._number:
                self._first_ns = t_ns
                if self._reported_ns is not None and t_ns - max(self._last_ns, self._reported_ns) >= LONGEST_S * 1e9:
                    self._reported_ns, self._wait_s = None, REPEATED_S
            self._number, self._last_ns, self._message = self._number + 1, t_ns, message
        if self._reported_ns is None or t_ns - self._reported_ns >= self._wait_s * 1e9:
            yield from self.rest(t_ns)

    def rest(self, t_ns: int) -> Iterator[Event]:
        """Report what has not been reported."""
        number, self._number = self._number, 0
        if not number:
            return
        message = self._message
        if self._reported_ns is not None:
            self._wait_s = min(2 * self._wait_s, LONGEST_S)
            from_s, to_s = ((ns - self._start_ns) * 1e-9 for ns in (self._first_ns, self._last_ns))
            several = f"{number} times from {from_s:.1f} s to {to_s:.1f} s"
            message += f"; once more at {from_s:.1f} s" if number == 1 else f"; {several}"
        self._reported_ns = t_ns
        yield warning_event(t_ns, self.source, self._reported(message))

    def _reported(self, message: str) -> str:
        """The message as it is reported now."""
        return message


class LossWarning(RepeatedWarning):
    """Losses that are counted: the message has the number since the last report."""

    def __init__(self, source: str, words: str, start_ns: int) -> None:
        super().__init__(source, start_ns)
        self._words, self._lost = words, 0

    def add(self, t_ns: int, number: int) -> Iterator[Event]:
        """Take the number of losses since the last call; report what is due."""
        self._lost += number
        return self.events(t_ns, f"{self._lost} {self._words}" if number else "")

    def _reported(self, message: str) -> str:
        self._lost = 0
        return message


class Condition(RepeatedWarning):
    """One condition with hysteresis; `above` is the share of affected rows that triggers a warning."""

    def __init__(self, above: float, source: str, start_ns: int) -> None:
        super().__init__(source, start_ns)
        self.above, self.share, self.since_ns, self.active = above, 0.0, 0, False
        self._shown, self._hidden_s, self._recovery = False, 0.0, ""

    def row(self, t_ns: int, period_s: float, part: float, warning: str, recovery: str) -> Iterator[Event]:
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
        if before and not active:
            lasted_s = (t_ns - self.since_ns) * 1e-9
            if self._shown:
                yield Event(t_ns, Level.INFO, self.source, f"{recovery}, after {lasted_s:.2f} s")
            else:
                self._hidden_s += lasted_s
            self._shown = False
        begins = active and not before
        if begins:
            self._recovery = recovery
        yield from self.events(t_ns, warning if begins else "")

    def _reported(self, message: str) -> str:
        if self._hidden_s:
            message += f", for {self._hidden_s:.2f} s in all"
        self._hidden_s, self._shown = 0.0, self.active
        return message if self.active else f"{message}; now {self._recovery}"


def warning_event(t_ns: int, source: str, message: str) -> Event:
    """The event of a warning about a condition that does not end the run."""
    return Event(t_ns, Level.WARNING, source, f"{message}; the run continues")
