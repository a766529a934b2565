"""Builds the trajectory of a protocol step by step: levels in Pa, segments with their source line."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from protocols.arrays import Array
from protocols.problems import BadInputError, Problem, raise_all
from protocols.source_positions import Document
from protocols.tip_inverse import HISTORY_S, HISTORY_STEP_S, TipInverse, TipRefusedError, TipRequest
from protocols.tip_paths import TipPath, fade
from protocols.tip_reference import GRID_S, TipMotion, TipReference
from protocols.trajectory import Prompt, SetPointTrajectory, StreamInterval, TrajectorySegment
from protocols.waveforms import Samples, Waveform

Path = tuple[str | int, ...]
LONGEST_TIP_S = 3600.0
"""Longest path of the tip: its samples are held in memory."""
SHORTEST_TIP_S = 1e-3
"""Shortest path of the tip, and shortest period of one: no arm answers within it."""


class TrajectoryBuilder:
    """The trajectory as far as it is built; steps read the present set-points [Pa] and append segments."""

    def __init__(
        self, actuators: int, document: Document, data: Mapping[Any, Any], inverse: TipInverse | None = None
    ) -> None:
        """Begin at 0 bar; data and inverse as for `expand`."""
        self._now_s = 0.0
        self._segments: list[TrajectorySegment] = []
        self._prompts: list[Prompt] = []
        self._streams: list[StreamInterval] = []
        self._problems: list[Problem] = []
        self._level_pa = [0.0] * actuators
        self._document = document
        self._data = data
        self._inverse = inverse
        self._motions: list[TipMotion] = []
        self._path: Path = ()
        self._line = 0

    def begin(self, path: Path, actuators: Sequence[int]) -> bool:
        """Begin the step at a path of the document; False if the rig has not all of its actuators."""
        self._line = self._document.position(path).key_line
        self._path = path
        have = len(self._level_pa)
        expected = f"an actuator that the rig has: {'1' if have == 1 else f'1 to {have}'}"
        lacking = [index for index, number in enumerate(actuators) if number > have]
        found = [self._document.problem((*path, "actuators", index), expected) for index in lacking]
        self._problems += [problem for problem in found if problem not in self._problems]
        return not lacking

    def trajectory(self) -> SetPointTrajectory:
        """The whole; `BadInputError` with all problems."""
        raise_all(self._problems)
        if not self._segments:
            expected = "at least one step that takes time"
            raise BadInputError([self._document.problem(("steps",), expected, "", at_key=True)])
        return SetPointTrajectory(
            self._now_s,
            len(self._level_pa),
            tuple(self._segments),
            tuple(self._prompts),
            self._document.file,
            TipReference(tuple(self._motions)),
            tuple(self._streams),
        )

    def level_pa(self, actuators: Sequence[int]) -> list[float]:
        """The present set-points of some actuators, numbered from 1."""
        return [self._level_pa[number - 1] for number in actuators]

    def data(self, step: object) -> Any:
        """The result of `LeafStep.read`."""
        return self._data[step]

    def move(
        self, kind: str, label: str, actuators: tuple[int, ...], duration_s: float, waves: Sequence[Waveform]
    ) -> None:
        """Append a segment that moves the set-points, one waveform [Pa] for each actuator."""
        moving = tuple((number - 1, wave) for number, wave in zip(actuators, waves, strict=True))
        for index, wave in moving:
            self._level_pa[index] = wave.at(duration_s)
        self._append(kind, label, actuators, duration_s, moving)

    def hold(
        self, kind: str, label: str, actuators: tuple[int, ...], duration_s: float, levels_pa: Sequence[float] = ()
    ) -> None:
        """Append a segment of constant set-points; with `levels_pa` its actuators jump to these first."""
        for number, level in zip(actuators if levels_pa else (), levels_pa, strict=True):
            self._level_pa[number - 1] = level
        self._append(kind, label, actuators, duration_s, (), jumps=bool(levels_pa))

    def stream(
        self, label: str, actuators: tuple[int, ...], duration_s: float, timeout_s: float, connect_s: float
    ) -> None:
        """Append a segment in which another program sets the pressures of these actuators."""
        start_s = self._now_s
        self._append("stream", label, actuators, duration_s, ())
        self._streams.append(StreamInterval(start_s, self._now_s, actuators, timeout_s, connect_s, self._line))

    def prompt(self, message: str, weight_g: float | None) -> None:
        """Pause here until the operator confirms the message."""
        self._prompts.append(Prompt(self._now_s, message, self._line, None if weight_g is None else weight_g * 1e-3))

    def follow(
        self, label: str, path: TipPath, coordinates: tuple[int, ...], lead_in_s: float, tolerance_m: float
    ) -> None:
        """Append the segments in which the tip follows a path."""
        if self._problems:
            return
        if fault := _time_fault(path, lead_in_s):
            found, expected = fault
            self._problems.append(self._document.problem(self._path, expected, found))
            return
        if self._inverse is None:
            self._problems.append(
                self._document.problem(self._path, "a rig: set-points of a tip path need its arm", "", at_key=True)
            )
            return
        request = TipRequest(path, lead_in_s, coordinates, tolerance_m, self._now_s, self._history(), self._weight_kg())
        try:
            solution = self._inverse.solve(request)
        except TipRefusedError as refused:
            self._problems.append(self._document.problem(self._path, refused.expected, refused.found))
            return
        begin_s, actuators = self._now_s, tuple(range(1, len(self._level_pa) + 1))
        for kind, words, from_s, to_s in (
            ("lead-in", f"into {label}", 0.0, lead_in_s),
            ("tip", label, lead_in_s, lead_in_s + path.duration_s),
        ):
            if to_s > from_s:
                waves = _part(solution.times_s, solution.pressure_pa, from_s, to_s)
                self.move(kind, words, actuators, to_s - from_s, waves)
        count = max(2, 1 + math.ceil((lead_in_s + path.duration_s) / GRID_S))
        times = np.linspace(0.0, lead_in_s + path.duration_s, count)
        position, velocity = fade(solution.start, path, lead_in_s, times - lead_in_s)
        free = [axis for axis in range(3) if axis not in coordinates]
        position[:, free] = velocity[:, free] = np.nan
        predicted = _interpolated(times, solution.times_s, solution.predicted_m)
        learned = np.zeros((count, 3))
        if solution.learned_m is not None:
            learned = _interpolated(times, solution.times_s, solution.learned_m)
        self._motions.append(
            TipMotion(
                begin_s, begin_s + lead_in_s, self._now_s, self._line, label, coordinates, path.period_s, tolerance_m,
                begin_s + times, position, velocity, predicted, learned,
            )
        )  # fmt: skip

    def _history(self) -> Array:
        """The set-points (k, N) [Pa] of the last HISTORY_S, oldest first; zero before the protocol."""
        count = round(HISTORY_S / HISTORY_STEP_S)
        rows = np.zeros((count + 1, len(self._level_pa)))
        rows[-1] = self._level_pa
        index = len(self._segments) - 1
        for k in range(count - 1, -1, -1):
            t_s = self._now_s - (count - k) * HISTORY_STEP_S
            while index > 0 and self._segments[index].start_s > t_s:
                index -= 1
            if t_s >= 0 and self._segments:
                rows[k] = self._segments[index].level_at(t_s)
        return rows

    def _weight_kg(self) -> float:
        return next((p.weight_kg for p in reversed(self._prompts) if p.weight_kg is not None), 0.0)

    def _append(
        self,
        kind: str,
        label: str,
        actuators: tuple[int, ...],
        duration_s: float,
        waves: tuple[tuple[int, Waveform], ...],
        *,
        jumps: bool = False,
    ) -> None:
        start_s, self._now_s = self._now_s, self._now_s + duration_s
        level_pa = tuple(self._level_pa)
        self._segments.append(
            TrajectorySegment(start_s, self._now_s, kind, label, actuators, self._line, level_pa, waves, jumps)
        )


def _time_fault(path: TipPath, lead_in_s: float) -> tuple[str, str] | None:
    """What is found and expected of the times of a path; None if they are possible."""
    if path.period_s is not None and path.period_s < SHORTEST_TIP_S:
        return f"a period of {path.period_s:.3g} s", f"a period of at least {SHORTEST_TIP_S:g} s"
    if path.duration_s < SHORTEST_TIP_S:
        return f"a path of {path.duration_s:.3g} s", f"a path of at least {SHORTEST_TIP_S:g} s"
    if (whole_s := lead_in_s + path.duration_s) > LONGEST_TIP_S:
        return f"{whole_s:.6g} s", f"at most {LONGEST_TIP_S:g} s"
    return None


def _part(times_s: Array, pressure_pa: Array, from_s: float, to_s: float) -> list[Samples]:
    """The waveforms of an interval of piecewise linear set-points, with times from its start."""
    inner = times_s[(times_s > from_s + 1e-9) & (times_s < to_s - 1e-9)]
    times = np.concatenate([[from_s], inner, [to_s]])
    # Adding zero turns the minus zero of a bound into zero.
    values = [np.interp(times, times_s, column) + 0.0 for column in pressure_pa.T]
    relative = tuple((times - from_s).tolist())
    return [Samples(relative, tuple(column.tolist()), held=False) for column in values]


def _interpolated(times_s: Array, at_s: Array, values: Array) -> Array:
    """Columns of values (n, m), interpolated linearly at times (k,)."""
    return np.column_stack([np.interp(times_s, at_s, column) for column in values.T])
