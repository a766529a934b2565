"""The trajectory of the set-points of a protocol, for the control loop."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from protocols.tip_reference import NO_TIP_REFERENCE, TipReference
from protocols.waveforms import Waveform


@dataclass(frozen=True)
class TrajectorySegment:
    """A time interval of the protocol with one waveform per actuator.

    `kind` is the kind of its step, or what the step makes of it: `dwell` and `rise` (one level of a staircase and the
    way to it), `lead-in`. `actuators` are the numbers, from 1, that it drives; `line` is its step's in the protocol's
    YAML (from 1); `level_pa` is the set-point of every actuator at its end, gauge [Pa].
    """

    start_s: float
    stop_s: float
    kind: str
    label: str
    actuators: tuple[int, ...]
    line: int
    level_pa: tuple[float, ...]
    waves: tuple[tuple[int, Waveform], ...] = field(default=(), repr=False)
    """Actuator index (from 0) and waveform of the moving actuators; the others are constant at `level_pa`."""
    jumps: bool = False
    """True if the set-points may change in a step at its start."""

    @property
    def still(self) -> bool:
        """True if all set-points are constant."""
        return not self.waves

    def level_at(self, t_s: float) -> list[float]:
        """Set-points [Pa] at a protocol time within it."""
        level = list(self.level_pa)
        for index, wave in self.waves:
            level[index] = wave.at(t_s - self.start_s)
        return level


@dataclass(frozen=True)
class Prompt:
    """The protocol pauses at `at_s` until the operator confirms `message`."""

    at_s: float
    message: str
    line: int
    weight_kg: float | None = None
    """Weight on the end cap after the prompt; None if the prompt does not change it."""


@dataclass(frozen=True)
class StreamInterval:
    """From `start_s` to `stop_s` another program sets the pressures of `actuators` (numbers, from 1).

    At most `timeout_s` may pass between two set-points, and `connect_s` until the first.
    """

    start_s: float
    stop_s: float
    actuators: tuple[int, ...]
    timeout_s: float
    connect_s: float
    line: int


@dataclass(frozen=True)
class SetPointTrajectory:
    """Set-points of N actuators from 0 to `duration_s`; `source` names the protocol's file.

    Before 0 the first set-points hold, after the end the last. At a jump the new level holds. A prompt's time lies
    at the start of a short segment that holds the levels, so that nothing moves before the operator has answered.
    """

    duration_s: float
    actuators: int
    segments: tuple[TrajectorySegment, ...]
    prompts: tuple[Prompt, ...]
    source: str
    tip: TipReference = NO_TIP_REFERENCE
    """Reference of the tip; the set-points of its motions are the feed-forward pressures."""
    streams: tuple[StreamInterval, ...] = ()
    """Intervals in which another program sets the pressures; the set-points are constant there."""
    _starts: tuple[float, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_starts", tuple(segment.start_s for segment in self.segments))

    def segment_at(self, t_s: float) -> TrajectorySegment:
        """The segment at a protocol time; the first before 0, the last from the end on."""
        return self.segments[max(bisect_right(self._starts, t_s) - 1, 0)]

    def setpoint_pa(self, t_s: float) -> NDArray[np.float64]:
        """Set-points (N,) [Pa, gauge] at a protocol time."""
        t_s = min(max(t_s, 0.0), self.duration_s)
        segment = self.segment_at(t_s)
        level = np.array(segment.level_pa)
        for index, wave in segment.waves:
            level[index] = wave.at(t_s - segment.start_s)
        return level

    def rate_pa_s(self, t_s: float) -> NDArray[np.float64]:
        """Rate of change (N,) [Pa/s] of the set-points just after a protocol time, without jumps."""
        rate = np.zeros(self.actuators)
        if 0.0 <= t_s < self.duration_s:
            segment = self.segment_at(t_s)
            for index, wave in segment.waves:
                rate[index] = wave.slope(t_s - segment.start_s)
        return rate

    def stream_at(self, t_s: float) -> StreamInterval | None:
        """The interval of streamed set-points at a protocol time; None outside."""
        return next((one for one in self.streams if one.start_s <= t_s < one.stop_s), None)

    def weight_kg(self, t_s: float) -> float:
        """Weight on the end cap [kg] at a protocol time; at the time of a prompt the weight before it."""
        hung = 0.0
        for prompt in self.prompts:
            if prompt.at_s >= t_s:
                break
            if prompt.weight_kg is not None:
                hung = prompt.weight_kg
        return hung

    def sample(self, t_s: Iterable[float]) -> NDArray[np.float64]:
        """Set-points (T, N) [Pa, gauge] at T protocol times."""
        times = np.clip(np.fromiter(t_s, dtype=np.float64), 0.0, self.duration_s)
        found = np.empty((len(times), self.actuators))
        for segment, rows in self._by_segment(times):
            found[rows] = segment.level_pa
            for index, wave in segment.waves:
                found[rows, index] = wave.values_at(times[rows] - segment.start_s)
        return found

    def rates_pa_s(self, t_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Rates of change (T, N) [Pa/s] just after T protocol times, as `rate_pa_s` gives them."""
        found = np.zeros((len(t_s), self.actuators))
        inside = np.flatnonzero((t_s >= 0.0) & (t_s < self.duration_s))
        for segment, rows in self._by_segment(t_s[inside]):
            for index, wave in segment.waves:
                found[inside[rows], index] = wave.slopes_at(t_s[inside[rows]] - segment.start_s)
        return found

    def _by_segment(self, t_s: NDArray[np.float64]) -> Iterator[tuple[TrajectorySegment, NDArray[np.intp]]]:
        """Each segment with times (T,) in it, and the indices of these times."""
        places = np.maximum(np.searchsorted(self._starts, t_s, side="right") - 1, 0)
        for place in np.unique(places).tolist():
            yield self.segments[place], np.flatnonzero(places == place)
