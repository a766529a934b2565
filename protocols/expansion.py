"""Expands protocol steps to a trajectory: repeats unrolled, levels in Pa, segments with their source line."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from protocols.arrays import Array
from protocols.problems import BadInputError, Problem, raise_all
from protocols.schema import InnerSteps, Step
from protocols.source_positions import Document
from protocols.steps.base import MOST_SEGMENTS, LeafStep
from protocols.tip_inverse import HISTORY_S, HISTORY_STEP_S, TipInverse, TipRefusedError, TipRequest
from protocols.tip_paths import TipPath, fade
from protocols.tip_reference import GRID_S, TipMotion, TipReference
from protocols.trajectory import Prompt, Segment, SetPointTrajectory, StreamInterval
from protocols.waveforms import Samples, Waveform

Path = tuple[str | int, ...]
LONGEST_TIP_S = 3600.0
"""Longest path of the tip: its samples are held in memory."""
SHORTEST_TIP_S = 1e-3
"""Shortest path of the tip, and shortest period of one: no arm answers within it."""


def too_long(steps: Sequence[Step], document: Document) -> list[Problem]:
    """Problems of steps that expand to more than `MOST_SEGMENTS` segments; found without expanding them."""
    found: list[Problem] = []
    _count(steps, ("steps",), document, found)
    return found


def _count(steps: Sequence[Step], base: Path, document: Document, found: list[Problem]) -> int:
    total = 0
    for index, step in enumerate(steps):
        body, at = step.body, (*base, index, step.kind)
        if isinstance(body, InnerSteps):
            count = body.times * _count(body.steps, (*at, *body.path), document, found)
            at = (*at, *body.count_path)
        else:
            count, decisive = body.most_segments
            at = (*at, *decisive)
        if count > MOST_SEGMENTS and not found:
            found.append(document.problem(at, f"less: at most {MOST_SEGMENTS} segments in all, and this makes more"))
        total += count
    if total > MOST_SEGMENTS and not found:
        found.append(
            document.problem(base, f"at most {MOST_SEGMENTS} segments in all; these make {total}", "", at_key=True)
        )
    return total


def expand(
    steps: Sequence[Step],
    actuators: int,
    document: Document,
    data: Mapping[LeafStep, Any],
    inverse: TipInverse | None = None,
) -> SetPointTrajectory:
    """The trajectory for a rig with N actuators; `BadInputError` if a step names an unknown one.

    data: results of `LeafStep.read`. inverse: solves for the set-points of `tip` steps.
    """
    expander = _Expander(actuators, document, data, inverse)
    expander.play(steps, ("steps",))
    raise_all(expander.problems)
    segments = tuple(expander.segments)
    if not segments:
        raise BadInputError([document.problem(("steps",), "at least one step that takes time", "", at_key=True)])
    return SetPointTrajectory(
        expander.now_s,
        actuators,
        segments,
        tuple(expander.prompts),
        document.file,
        expander.tip(),
        tuple(expander.streams),
    )


class _Expander:
    """The `TrajectoryBuilder` of the steps."""

    def __init__(
        self, actuators: int, document: Document, data: Mapping[LeafStep, Any], inverse: TipInverse | None
    ) -> None:
        self.now_s = 0.0
        self.segments: list[Segment] = []
        self.prompts: list[Prompt] = []
        self.streams: list[StreamInterval] = []
        self.problems: list[Problem] = []
        self._level_pa = [0.0] * actuators
        self._document = document
        self._data = data
        self._inverse = inverse
        self._motions: list[TipMotion] = []
        self._path: Path = ()
        self._line = 0

    def play(self, steps: Sequence[Step], base: Path) -> None:
        for index, step in enumerate(steps):
            body, here = step.body, (*base, index, step.kind)
            if isinstance(body, InnerSteps):
                for _ in range(body.times):
                    self.play(body.steps, (*here, *body.path))
            elif not self._lacking(body, here):
                self._line = self._document.position(here).key_line
                self._path = here
                body.play(self)

    def level_pa(self, actuators: Sequence[int]) -> list[float]:
        return [self._level_pa[number - 1] for number in actuators]

    def data(self, step: LeafStep) -> Any:
        return self._data[step]

    def move(
        self, kind: str, label: str, actuators: tuple[int, ...], duration_s: float, waves: Sequence[Waveform]
    ) -> None:
        moving = tuple((number - 1, wave) for number, wave in zip(actuators, waves, strict=True))
        for index, wave in moving:
            self._level_pa[index] = wave.at(duration_s)
        self._append(kind, label, actuators, duration_s, moving)

    def hold(
        self, kind: str, label: str, actuators: tuple[int, ...], duration_s: float, levels_pa: Sequence[float] = ()
    ) -> None:
        for number, level in zip(actuators if levels_pa else (), levels_pa, strict=True):
            self._level_pa[number - 1] = level
        self._append(kind, label, actuators, duration_s, (), jumps=bool(levels_pa))

    def stream(
        self, label: str, actuators: tuple[int, ...], duration_s: float, timeout_s: float, connect_s: float
    ) -> None:
        start_s = self.now_s
        self._append("stream", label, actuators, duration_s, ())
        self.streams.append(StreamInterval(start_s, self.now_s, actuators, timeout_s, connect_s, self._line))

    def prompt(self, message: str, weight_g: float | None) -> None:
        self.prompts.append(Prompt(self.now_s, message, self._line, None if weight_g is None else weight_g * 1e-3))

    def follow(
        self, label: str, path: TipPath, coordinates: tuple[int, ...], lead_in_s: float, tolerance_m: float
    ) -> None:
        if self.problems:
            return
        if fault := _time_fault(path, lead_in_s):
            found, expected = fault
            self.problems.append(self._document.problem(self._path, expected, found))
            return
        if self._inverse is None:
            self.problems.append(
                self._document.problem(self._path, "a rig: set-points of a tip path need its arm", "", at_key=True)
            )
            return
        request = TipRequest(path, lead_in_s, coordinates, tolerance_m, self.now_s, self._history(), self._weight_kg())
        try:
            solution = self._inverse.solve(request)
        except TipRefusedError as refused:
            self.problems.append(self._document.problem(self._path, refused.expected, refused.found))
            return
        begin_s, actuators = self.now_s, tuple(range(1, len(self._level_pa) + 1))
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
                begin_s, begin_s + lead_in_s, self.now_s, self._line, label, coordinates, path.period_s, tolerance_m,
                begin_s + times, position, velocity, predicted, learned,
            )
        )  # fmt: skip

    def tip(self) -> TipReference:
        return TipReference(tuple(self._motions))

    def _history(self) -> Array:
        """The set-points (k, N) [Pa] of the last HISTORY_S, oldest first; zero before the protocol."""
        count = round(HISTORY_S / HISTORY_STEP_S)
        rows = np.zeros((count + 1, len(self._level_pa)))
        rows[-1] = self._level_pa
        index = len(self.segments) - 1
        for k in range(count - 1, -1, -1):
            t_s = self.now_s - (count - k) * HISTORY_STEP_S
            while index > 0 and self.segments[index].start_s > t_s:
                index -= 1
            if t_s >= 0 and self.segments:
                rows[k] = self.segments[index].level_at(t_s)
        return rows

    def _weight_kg(self) -> float:
        return next((p.weight_kg for p in reversed(self.prompts) if p.weight_kg is not None), 0.0)

    def _lacking(self, body: Any, here: Path) -> bool:
        lacking = False
        for index, number in enumerate(getattr(body, "actuators", None) or ()):
            if number > len(self._level_pa):
                lacking = True
                have = len(self._level_pa)
                expected = f"an actuator that the rig has: {'1' if have == 1 else f'1 to {have}'}"
                problem = self._document.problem((*here, "actuators", index), expected)
                if problem not in self.problems:
                    self.problems.append(problem)
        return lacking

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
        start_s, self.now_s = self.now_s, self.now_s + duration_s
        level_pa = tuple(self._level_pa)
        self.segments.append(Segment(start_s, self.now_s, kind, label, actuators, self._line, level_pa, waves, jumps))


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
