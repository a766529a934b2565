"""Expands protocol steps to a trajectory: repeats unrolled, levels in Pa, segments with their source line."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from protocols.csv_samples import Columns
from protocols.decimals import pa, stair_count
from protocols.problems import BadInputError, Problem
from protocols.schema import MOST_SEGMENTS, Csv, Hold, PromptStep, Ramp, Repeat, Sine, Staircase, Step, each
from protocols.source_positions import Document, path_text
from protocols.trajectory import Prompt, Segment, Trajectory
from protocols.waveforms import Fade, Line, Samples, Sinusoid, Smooth, Waveform

PROMPT_S = 0.1
"""Duration of a prompt's segment, in which the set-points are constant."""

Path = tuple[str | int, ...]


def too_long(steps: Sequence[Step], document: Document) -> list[Problem]:
    """Problems of steps that expand to more than `MOST_SEGMENTS` segments; found without expanding them."""
    found: list[Problem] = []
    _count(steps, ("steps",), document, found)
    return found


def _count(steps: Sequence[Step], base: Path, document: Document, found: list[Problem]) -> int:
    total = 0
    for index, step in enumerate(steps):
        here = (*base, index)
        body = getattr(step, step.kind)
        at = (*here, step.kind)
        if isinstance(body, Staircase):
            count, at = 2 * stair_count(body.start_bar, body.stop_bar, body.step_bar), (*at, "step_bar")
        elif isinstance(body, Repeat):
            count, at = body.times * _count(body.steps, (*at, "steps"), document, found), (*at, "times")
        elif isinstance(body, tuple):
            count = _count(body, at, document, found)
        else:
            count = 1
        if count > MOST_SEGMENTS and not found:
            found.append(_problem(document, at, f"less: at most {MOST_SEGMENTS} segments in all, and this makes more"))
        total += count
    if total > MOST_SEGMENTS and not found:
        found.append(_problem(document, base, f"at most {MOST_SEGMENTS} segments in all; these make {total}", ""))
    return total


def expand(
    steps: Sequence[Step], actuators: int, document: Document, samples: Mapping[tuple[str, tuple[int, ...]], Columns]
) -> Trajectory:
    """The trajectory for a rig with so many actuators, or `BadInputError` if a step names an unknown one."""
    expander = _Expander(actuators, document, samples)
    expander.play(steps, ("steps",))
    if expander.problems:
        raise BadInputError(expander.problems)
    segments = tuple(expander.segments)
    if not segments:
        raise BadInputError([_problem(document, ("steps",), "at least one step that takes time", "")])
    return Trajectory(expander.now_s, actuators, segments, tuple(expander.prompts), document.file)


class _Expander:
    def __init__(
        self, actuators: int, document: Document, samples: Mapping[tuple[str, tuple[int, ...]], Columns]
    ) -> None:
        self.now_s = 0.0
        self.segments: list[Segment] = []
        self.prompts: list[Prompt] = []
        self.problems: list[Problem] = []
        self._level_pa = [0.0] * actuators
        self._document = document
        self._samples = samples
        self._waves: dict[tuple[str, tuple[int, ...], bool], tuple[Samples, ...]] = {}
        self._players: dict[str, Callable[[Any, int], None]] = {
            "ramp": self._ramp,
            "staircase": self._staircase,
            "sine": self._sine,
            "hold": self._hold,
            "csv": self._csv,
            "prompt": self._prompt,
        }

    def play(self, steps: Sequence[Step], base: Path) -> None:
        for index, step in enumerate(steps):
            kind = step.kind
            body = getattr(step, kind)
            here = (*base, index, kind)
            if isinstance(body, Repeat):
                for _ in range(body.times):
                    self.play(body.steps, (*here, "steps"))
            elif isinstance(body, tuple):
                self.play(body, here)
            elif not self._lacking(body, here):
                self._players[kind](body, self._document.position(here).key_line)

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

    def _ramp(self, step: Ramp, line: int) -> None:
        targets = [pa(bar) for bar in each(step.to_bar, len(step.actuators))]
        starts = [self._level_pa[number - 1] for number in step.actuators]
        duration_s = step.duration_s
        if duration_s is None:
            assert step.rate_bar_per_s is not None
            farthest = max(abs(b - a) for a, b in zip(starts, targets, strict=True))
            # A smooth ramp is steepest in its middle, 15/8 of its mean slope.
            duration_s = farthest / pa(step.rate_bar_per_s) * (1.875 if step.shape == "smooth" else 1.0)
        shape = Smooth if step.shape == "smooth" else Line
        label = step.label or "to " + _levels_text(step.to_bar)
        if duration_s > 0:
            waves = [shape(a, b, duration_s) for a, b in zip(starts, targets, strict=True)]
            self._move("ramp", label, step.actuators, line, duration_s, waves)

    def _staircase(self, step: Staircase, line: int) -> None:
        for bar in step.levels_bar():
            target, label = pa(bar), f"{bar:g} bar"
            label = f"{step.label}, {label}" if step.label else label
            starts = [self._level_pa[number - 1] for number in step.actuators]
            if step.rise_s > 0 and any(start != target for start in starts):
                waves = [Line(start, target, step.rise_s) for start in starts]
                self._move("rise", label, step.actuators, line, step.rise_s, waves)
            for number in step.actuators:
                self._level_pa[number - 1] = target
            self._stand("dwell", label, step.actuators, line, step.dwell_s)

    def _sine(self, step: Sine, line: int) -> None:
        count = len(step.actuators)
        if step.omega_rad_s is not None:
            omegas = each(step.omega_rad_s, count)
        else:
            omegas = tuple(2 * math.pi * hz for hz in each(step.frequency_hz or 0.0, count))
        if step.phase_rad is not None:
            phases = each(step.phase_rad, count)
        else:
            phases = tuple(math.radians(deg) for deg in each(step.phase_deg or 0.0, count))
        means, amplitudes = each(step.mean_bar, count), each(step.amplitude_bar, count)
        sines = [
            Sinusoid(pa(mean), pa(amplitude), omega, phase)
            for mean, amplitude, omega, phase in zip(means, amplitudes, omegas, phases, strict=True)
        ]
        label = step.label or "sine"
        if step.lead_in_s > 0:
            starts = [self._level_pa[number - 1] for number in step.actuators]
            fades = [Fade(start, sine, step.lead_in_s) for start, sine in zip(starts, sines, strict=True)]
            self._move("lead-in", f"into {label}", step.actuators, line, step.lead_in_s, fades)
        duration_s = step.duration_s if step.duration_s is not None else (step.periods or 0) * 2 * math.pi / omegas[0]
        self._move("sine", label, step.actuators, line, duration_s, sines)

    def _hold(self, step: Hold, line: int) -> None:
        label = step.label or "hold"
        if step.actuators is not None and step.level_bar is not None:
            label = step.label or _levels_text(step.level_bar)
            for number, bar in zip(step.actuators, each(step.level_bar, len(step.actuators)), strict=True):
                self._level_pa[number - 1] = pa(bar)
        self._stand("hold", label, step.actuators or (), line, step.duration_s)

    def _csv(self, step: Csv, line: int) -> None:
        held = step.between == "hold"
        key = (step.file, step.actuators, held)
        if key not in self._waves:
            columns = self._samples[step.file, step.actuators]
            self._waves[key] = tuple(Samples(columns.times_s, tuple(map(pa, column)), held) for column in columns.bar)
        waves = self._waves[key]
        label = step.label or step.file
        if step.lead_in_s > 0:
            leads = [
                Smooth(self._level_pa[number - 1], wave.values[0], step.lead_in_s)
                for number, wave in zip(step.actuators, waves, strict=True)
            ]
            self._move("lead-in", f"into {label}", step.actuators, line, step.lead_in_s, leads)
        self._move("csv", label, step.actuators, line, waves[0].times_s[-1], waves)

    def _prompt(self, step: str | PromptStep, line: int) -> None:
        message, weight_g = (step, None) if isinstance(step, str) else (step.message, step.weight_g)
        self.prompts.append(Prompt(self.now_s, message, line, None if weight_g is None else weight_g * 1e-3))
        self._stand("prompt", message, (), line, PROMPT_S)

    def _move(
        self,
        kind: str,
        label: str,
        actuators: tuple[int, ...],
        line: int,
        duration_s: float,
        waves: Sequence[Waveform],
    ) -> None:
        moving = tuple((number - 1, wave) for number, wave in zip(actuators, waves, strict=True))
        for index, wave in moving:
            self._level_pa[index] = wave.at(duration_s)
        self._append(kind, label, actuators, line, duration_s, moving)

    def _stand(self, kind: str, label: str, actuators: tuple[int, ...], line: int, duration_s: float) -> None:
        self._append(kind, label, actuators, line, duration_s, ())

    def _append(
        self,
        kind: str,
        label: str,
        actuators: tuple[int, ...],
        line: int,
        duration_s: float,
        waves: tuple[tuple[int, Waveform], ...],
    ) -> None:
        start_s, self.now_s = self.now_s, self.now_s + duration_s
        self.segments.append(Segment(start_s, self.now_s, kind, label, actuators, line, tuple(self._level_pa), waves))


def _levels_text(bar: float | tuple[float, ...]) -> str:
    values = bar if isinstance(bar, tuple) else (bar,)
    return " / ".join(f"{value:g}" for value in values) + " bar"


def _problem(document: Document, path: Path, expected: str, value: str | None = None) -> Problem:
    position = document.position(path)
    line, column = (
        (position.key_line, position.key_column)
        if value == "" and position.key_line
        else (position.line, position.column)
    )
    found = position.source if value is None else value
    return Problem(document.file, line, column, path_text(path), found, expected)
