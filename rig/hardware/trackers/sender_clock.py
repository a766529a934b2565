"""Offset and drift of a sender's clock from the one-way delays of its messages.

The delay of a message is at least the constant part of the delay. The differences of the times of arrival and of
sending therefore lie above a line, whose slope is the drift. The line is an edge of their lower convex hull: that which
makes the sum of the distances smallest (Moon, Skelly, Towsley, INFOCOM 1999; Zhang, Liu, Xia, INFOCOM 2002). One-way
delays cannot tell the constant part of the delay from the offset: the line contains it.

A drift that changes bends the line. Then even the smallest of the newest differences lies above it. The uncertainty
contains that distance; where it is more than chance allows, older differences are forgotten.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.hardware.trackers.base import ClockEstimate

WINDOW_S = 60.0
"""Time over which the drift is taken as constant."""
BIN_S = 0.1
"""Of the messages in a bin only the one with the smallest delay is kept."""
STEP_S = 2e-3
"""Smallest step of the sender's clock that is detected; jitter hides a smaller one that makes delays longer."""
STEP_SPAN_S = 0.5
"""Time with longer delays after which the sender's clock has been set back."""
STEP_MESSAGES, LONGER_MESSAGES = 10, 20
"""Messages with an earlier, or longer, delay that make a step."""
STEP_AMONG = 40
"""The earlier ones are among so many: after a small step, jitter brings some back to the old line."""
LEAST_MESSAGES, LEAST_SPAN_S = 20, 0.4
"""Messages and time before the estimate is used."""
LARGEST_DRIFT = 200e-6
"""Quartz clocks drift by less."""
_ORDER = 8
_COVERAGE_FACTOR = 8.0
"""The distance between the smallest excess delays times this is the standard uncertainty; see the validation page."""
_PLAUSIBLE_STDS = 6.0
_LONGER = 5.0
WANDER = 10e-6
"""The uncertainty allows for such a change of the drift, which stays unseen until a message has a small delay."""
_SCALES = (1, 5, 20, 80)
"""Numbers of newest bins whose smallest difference has to lie near the line."""
_SHORTENS = 20
"""A misfit of this many bins or more is that of the drift: the older half of the bins is forgotten."""
_UNUSUAL = 4.0
"""Chance allows the smallest of n bins this distance from the line, in units of the scatter of a bin over sqrt(n)."""


@dataclass(frozen=True)
class _Line:
    """y = intercept + slope x, with the standard uncertainty at the newest x.

    `chance` is the part of `std` that the random delays cause. `bent` is true where the newest differences lie above
    the line: the drift has changed.
    """

    intercept: float
    slope: float
    chance: float
    std: float
    bent: bool

    def at(self, x: float) -> float:
        return self.intercept + self.slope * x


class SenderClock:
    """Recursive estimate over the last minute; it uses no clock of its own."""

    def __init__(self, largest_drift: float = LARGEST_DRIFT) -> None:
        self._largest = largest_drift
        self.steps = 0
        """Steps of the sender's clock so far."""
        self._begin()

    def _begin(self) -> None:
        self._origin: tuple[int, int] | None = None
        self._bins: deque[tuple[int, float, float]] = deque(maxlen=round(WINDOW_S / BIN_S))
        self._recent: deque[tuple[int, float, float]] = deque()
        self._below: deque[tuple[int, int, int]] = deque()
        self._added = 0
        self._messages = 0
        self._newest_s = -math.inf
        self._went_back = False
        self._line: _Line | None = None

    def add(self, sent_ns: int, arrived_ns: int) -> bool:
        """Take a message into account, in the order of sending; False while its time contradicts those before it.

        Several such messages, or longer delays for `STEP_SPAN_S`, count as a step: the estimate begins anew. A time
        before that of the message before contradicts it, and so do those that follow, until one lies near the line.
        """
        if self._origin is None:
            self._origin = sent_ns, arrived_ns - sent_ns
        x = (sent_ns - self._origin[0]) * 1e-9
        y = (arrived_ns - sent_ns - self._origin[1]) * 1e-9
        line = self._line
        self._added += 1
        while self._below and self._below[0][0] <= self._added - STEP_AMONG:
            self._below.popleft()
        if line is not None and self.ready and y < line.at(x) - max(STEP_S, _PLAUSIBLE_STDS * line.chance):
            self._below.append((self._added, sent_ns, arrived_ns))
            if len(self._below) >= STEP_MESSAGES:
                self._restart([(sent, arrived) for _, sent, arrived in self._below])
            return False
        backwards, self._newest_s = x < self._newest_s, x
        if backwards and not self.ready:
            self._restart([(sent_ns, arrived_ns)])
            return False
        if backwards:
            # The messages before and after have different clocks: a step is judged by those that come after.
            self._went_back = True
            self._recent.clear()
        if self._went_back and line is not None:
            self._went_back = y > line.at(x) + STEP_S
        self._recent.append((arrived_ns, x, y))
        while len(self._recent) > LONGER_MESSAGES and self._recent[1][0] < arrived_ns - STEP_SPAN_S * 1e9:
            self._recent.popleft()
        if self._set_back():
            origin_ns = self._origin[0]
            self._restart([(origin_ns + round(a * 1e9), at_ns) for at_ns, a, _ in self._recent])
            return False
        if self._went_back:
            return False
        self._keep(x, y)
        return True

    @property
    def ready(self) -> bool:
        """True once there are messages enough for an estimate."""
        return (
            self._line is not None
            and self._messages >= LEAST_MESSAGES
            and self._bins[-1][1] - self._bins[0][1] >= LEAST_SPAN_S
        )

    def estimate(self, sent_ns: int) -> ClockEstimate:
        """The estimate at a time of the sender; only while `ready`."""
        assert self._origin is not None
        assert self._line is not None
        x = (sent_ns - self._origin[0]) * 1e-9
        return ClockEstimate(self._origin[1] * 1e-9 + self._line.at(x), self._line.slope, self._line.std)

    def ours_ns(self, sent_ns: int) -> int:
        """Our time of a time of the sender, later by the constant part of the delay; only while `ready`."""
        assert self._origin is not None
        assert self._line is not None
        x = (sent_ns - self._origin[0]) * 1e-9
        return sent_ns + self._origin[1] + round(self._line.at(x) * 1e9)

    def _restart(self, messages: list[tuple[int, int]]) -> None:
        self.steps += 1
        self._begin()
        for sent_ns, arrived_ns in messages:
            self.add(sent_ns, arrived_ns)

    def _set_back(self) -> bool:
        """True where every delay of the last second is longer than any smallest delay of a second before."""
        line = self._line
        if line is None or not self.ready or len(self._recent) < LONGER_MESSAGES:
            return False
        if self._recent[-1][0] - self._recent[0][0] < STEP_SPAN_S * 1e9:
            return False
        smallest = min(b - line.at(a) for _, a, b in self._recent)
        if smallest <= STEP_S:
            return False
        recent = {a for _, a, _ in self._recent}
        by_second: dict[int, float] = {}
        for _, a, b in self._bins:
            if a not in recent:
                by_second[int(a)] = min(by_second.get(int(a), np.inf), b - line.at(a))
        return bool(by_second) and smallest > _LONGER * max(by_second.values())

    def _keep(self, x: float, y: float) -> None:
        self._messages += 1
        slope = self._line.slope if self._line is not None else 0.0
        number = int(x // BIN_S)
        if self._bins and self._bins[-1][0] >= number:
            if y - slope * x >= self._bins[-1][2] - slope * self._bins[-1][1]:
                return
            self._bins[-1] = (self._bins[-1][0], x, y)
            # A message in an open bin changes the estimate only if it lies below the line.
            if self._line is not None and y >= self._line.at(x):
                return
        else:
            self._bins.append((number, x, y))
        line = self._fit()
        while line.bent and len(self._bins) > 2 * _SHORTENS:
            for _ in range(len(self._bins) // 2):
                self._bins.popleft()
            line = self._fit()
        self._line = line

    def _fit(self) -> _Line:
        points = [(x, y) for _, x, y in self._bins]
        hull: list[tuple[float, float]] = []
        for point in points:
            while len(hull) > 1 and _clockwise(hull[-2], hull[-1], point):
                hull.pop()
            hull.append(point)
        x, y = np.array(points).T
        middle, slope = float(x.mean()), 0.0
        for (x0, y0), (x1, y1) in itertools.pairwise(hull):
            slope = (y1 - y0) / (x1 - x0)
            if x1 >= middle:
                break
        slope = float(np.clip(slope, -self._largest, self._largest))
        above = y - slope * x
        intercept = float(above.min())
        excess = np.sort(above - intercept)
        k = min(_ORDER, len(excess)) - 1
        chance = _COVERAGE_FACTOR * float(excess[k]) / k if k > 0 else np.inf
        scatter = float(np.median(np.abs(np.diff(above)))) / np.log(2.0) if len(above) > 1 else 0.0
        unseen = math.sqrt(WANDER * BIN_S * scatter)
        misfit, bent = _misfit(above - intercept, scatter)
        return _Line(intercept, slope, chance, math.hypot(chance, misfit, unseen), bent)


def _misfit(excess: NDArray[np.float64], scatter: float) -> tuple[float, bool]:
    """Distance of the newest bins from the line, and whether it is more than chance allows in many bins.

    The true line lies at most the smallest excess of the newest bins above the estimated one, as far as the drift was
    constant in them: a quarter of the bins, and fewer where chance does not explain their distance. The `scatter` of a
    bin comes from differences of neighbours, which a bent line hardly changes. Of the newest bin too few messages may
    have come: it counts beside the number.
    """
    found, bent = float(excess[-1 - min(len(excess) // 4, _SCALES[-1]) :].min()), False
    for n in _SCALES:
        smallest = float(excess[-n - 1 :].min())
        if n + 1 < len(excess) and smallest > _UNUSUAL * scatter / np.sqrt(n):
            found, bent = max(found, smallest), bent or n >= _SHORTENS
    return found, bent


def _clockwise(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> bool:
    return (b[0] - a[0]) * (c[1] - a[1]) <= (b[1] - a[1]) * (c[0] - a[0])
