"""Expands protocol steps to a trajectory: repeats unrolled, levels in Pa, segments with their source line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from protocols.problems import BadInputError, Problem
from protocols.schema import Repeat, Step
from protocols.source_positions import Document, path_text
from protocols.steps.base import MOST_SEGMENTS, LeafStep
from protocols.trajectory import Prompt, Segment, SetPointTrajectory
from protocols.waveforms import Waveform

Path = tuple[str | int, ...]


def too_long(steps: Sequence[Step], document: Document) -> list[Problem]:
    """Problems of steps that expand to more than `MOST_SEGMENTS` segments; found without expanding them."""
    found: list[Problem] = []
    _count(steps, ("steps",), document, found)
    return found


def _count(steps: Sequence[Step], base: Path, document: Document, found: list[Problem]) -> int:
    total = 0
    for index, step in enumerate(steps):
        body, at = step.body, (*base, index, step.kind)
        if isinstance(body, Repeat):
            count, at = body.times * _count(body.steps, (*at, "steps"), document, found), (*at, "times")
        elif isinstance(body, tuple):
            count = _count(body, at, document, found)
        else:
            count, decisive = body.most_segments
            at = (*at, *decisive)
        if count > MOST_SEGMENTS and not found:
            found.append(_problem(document, at, f"less: at most {MOST_SEGMENTS} segments in all, and this makes more"))
        total += count
    if total > MOST_SEGMENTS and not found:
        found.append(_problem(document, base, f"at most {MOST_SEGMENTS} segments in all; these make {total}", ""))
    return total


def expand(
    steps: Sequence[Step], actuators: int, document: Document, data: Mapping[LeafStep, Any]
) -> SetPointTrajectory:
    """The trajectory for a rig with so many actuators, or `BadInputError` if a step names an unknown one.

    `data` is what the `read` of the steps has returned.
    """
    expander = _Expander(actuators, document, data)
    expander.play(steps, ("steps",))
    if expander.problems:
        raise BadInputError(expander.problems)
    segments = tuple(expander.segments)
    if not segments:
        raise BadInputError([_problem(document, ("steps",), "at least one step that takes time", "")])
    return SetPointTrajectory(expander.now_s, actuators, segments, tuple(expander.prompts), document.file)


class _Expander:
    """The `Player` of the steps."""

    def __init__(self, actuators: int, document: Document, data: Mapping[LeafStep, Any]) -> None:
        self.now_s = 0.0
        self.segments: list[Segment] = []
        self.prompts: list[Prompt] = []
        self.problems: list[Problem] = []
        self._level_pa = [0.0] * actuators
        self._document = document
        self._data = data
        self._line = 0

    def play(self, steps: Sequence[Step], base: Path) -> None:
        for index, step in enumerate(steps):
            body, here = step.body, (*base, index, step.kind)
            if isinstance(body, Repeat):
                for _ in range(body.times):
                    self.play(body.steps, (*here, "steps"))
            elif isinstance(body, tuple):
                self.play(body, here)
            elif not self._lacking(body, here):
                self._line = self._document.position(here).key_line
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

    def stand(
        self, kind: str, label: str, actuators: tuple[int, ...], duration_s: float, levels_pa: Sequence[float] = ()
    ) -> None:
        for number, level in zip(actuators if levels_pa else (), levels_pa, strict=True):
            self._level_pa[number - 1] = level
        self._append(kind, label, actuators, duration_s, (), jumps=bool(levels_pa))

    def prompt(self, message: str, weight_g: float | None) -> None:
        self.prompts.append(Prompt(self.now_s, message, self._line, None if weight_g is None else weight_g * 1e-3))

    def _lacking(self, body: Any, here: Path) -> bool:
        lacking = False
        for index, number in enumerate(getattr(body, "actuators", None) or ()):
            if number > len(self._level_pa):
                lacking = True
                have = len(self._level_pa)
                expected = f"an actuator that the rig has: {'1' if have == 1 else f'1 to {have}'}"
                problem = _problem(self._document, (*here, "actuators", index), expected)
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


def _problem(document: Document, path: Path, expected: str, value: str | None = None) -> Problem:
    position = document.position(path)
    line, column = (
        (position.key_line, position.key_column)
        if value == "" and position.key_line
        else (position.line, position.column)
    )
    found = position.source if value is None else value
    return Problem(document.file, line, column, path_text(path), found, expected)
