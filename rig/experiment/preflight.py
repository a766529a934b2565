"""Preflight check of a trajectory against a rig's limits; every problem names the line of its protocol step."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from model.units import PA_PER_BAR
from protocols import Problem, Protocol, SetPointTrajectory, TrajectorySegment
from rig.config.schema import RigConfig

JUMP_PA = 500.0
"""Largest change between segments that is not a jump; half the accuracy of the paper's sensors."""

TINY_PA = 1e-3
"""Tolerance for equal pressures."""


def check(
    config: RigConfig, trajectory: SetPointTrajectory, protocol: Protocol | None = None, rig_file: Path | None = None
) -> tuple[Problem, ...]:
    """Return every violation by `trajectory`: level, rate, jumps, duration, and shared valves.

    `protocol` and `rig_file` add details to the messages: the step's path, and the file that states the limit.
    """
    rig = f" in {rig_file.name}" if rig_file else ""
    return _PreflightCheck(config, trajectory, protocol, rig).problems()


def peak_pa(trajectory: SetPointTrajectory) -> list[float]:
    """Return the highest set-point of each actuator [Pa]."""
    highest = zip(*([high for _, high, _ in _extremes(segment)] for segment in trajectory.segments), strict=True)
    return [max(levels) for levels in highest]


def trough_pa(trajectory: SetPointTrajectory) -> float:
    """Return the lowest set-point of all actuators [Pa]."""
    return min(low for segment in trajectory.segments for low, _, _ in _extremes(segment))


@dataclass(frozen=True)
class _PreflightCheck:
    config: RigConfig
    trajectory: SetPointTrajectory
    protocol: Protocol | None
    rig: str

    def problems(self) -> tuple[Problem, ...]:
        have, want = self.config.actuators, self.trajectory.actuators
        if have != want:
            expected = f"a trajectory for the {have} actuators of the rig"
            return (Problem(self.trajectory.source, 0, 0, "", f"one for {want}", expected),)
        worst: dict[tuple[int, str], tuple[float, Problem]] = {}
        before = (0.0,) * have
        for segment in self.trajectory.segments:
            for rule, excess, problem in self._violations(segment, before):
                key = (segment.line, rule)
                if key not in worst or excess > worst[key][0]:
                    worst[key] = (excess, problem)
            before = segment.level_pa
        problems = [*self._streams(), *(problem for _, problem in worst.values())]
        return tuple(sorted((*self._duration(), *problems), key=lambda problem: problem.line))

    def _duration(self) -> Iterator[Problem]:
        longest, takes = self.config.limits.duration_s, self.trajectory.duration_s
        if takes > longest:
            expected = f"at most {longest:g} s (limits, duration_s{self.rig})"
            yield Problem(self.trajectory.source, 0, 0, "the whole protocol", f"{takes:.6g} s", expected)

    def _streams(self) -> Iterator[Problem]:
        """Check that a step that another program drives has all actuators of each of its valves."""
        for interval in self.trajectory.streams:
            for number, valve in enumerate(self.config.valves, start=1):
                lacking = sorted(set(valve.actuators) - set(interval.actuators))
                if lacking and len(lacking) < len(valve.actuators):
                    where, column = self.protocol.step_at(interval.line) if self.protocol else ("stream", 0)
                    found = f"actuators {', '.join(map(str, interval.actuators))}"
                    expected = f"also actuator {lacking[0]}: valves #{number}{self.rig} drives it with another one"
                    yield Problem(self.trajectory.source, interval.line, column, where, found, expected)

    def _violations(
        self, segment: TrajectorySegment, before: tuple[float, ...]
    ) -> Iterator[tuple[str, float, Problem]]:
        """Yield each violated rule, the excess, and the problem."""
        limits = self.config.limits
        highest, lowest = limits.pressure_bar * PA_PER_BAR, limits.lowest_pressure_bar * PA_PER_BAR
        fastest = limits.rate_bar_per_s * PA_PER_BAR
        levels = _extremes(segment)
        for index, (low, high, slope) in enumerate(levels):
            who = f"actuator {index + 1}"
            # A step that only starts where an earlier one has gone too far is not at fault itself.
            sets = index + 1 in segment.actuators
            ends = segment.level_pa[index]
            too_high = high > (highest if sets and ends > highest else max(highest, before[index])) + TINY_PA
            too_low = low < (lowest if sets and ends < lowest else min(lowest, before[index])) - TINY_PA
            if too_high:
                expected = f"at most {limits.pressure_bar:g} bar (limits, pressure_bar{self.rig})"
                yield "level", high - highest, self._problem(segment, f"{who} at {_bar(high)}", expected)
            if too_low:
                expected = f"at least {limits.lowest_pressure_bar:g} bar (limits, lowest_pressure_bar{self.rig})"
                yield "below", lowest - low, self._problem(segment, f"{who} at {_bar(low)}", expected)
            if slope > fastest * (1 + 1e-9):
                expected = f"at most {limits.rate_bar_per_s:g} bar/s (limits, rate_bar_per_s{self.rig})"
                yield "rate", slope - fastest, self._problem(segment, f"{who} at {_bar(slope)}/s", expected)
        first = segment.level_at(segment.start_s)
        # The reference needs this long for a jump; the tracking interlock then ends the run before it has arrived.
        farthest = fastest * limits.tracking_s + limits.tracking_bar * PA_PER_BAR
        for index, (old, new) in enumerate(zip(before, first, strict=True)):
            jump = abs(new - old)
            if segment.jumps and jump > farthest and segment.stop_s - segment.start_s > limits.tracking_s:
                found = f"actuator {index + 1} jumps from {_bar(old)} to {_bar(new)}"
                expected = (
                    f"a jump of at most {_bar(farthest)}, which {limits.rate_bar_per_s:g} bar/s permits within "
                    f"{limits.tracking_s:g} s (limits, rate_bar_per_s, tracking_s{self.rig}); or put a ramp before it"
                )
                yield "far jump", jump, self._problem(segment, found, expected)
            if not segment.jumps and jump > JUMP_PA:
                found = f"actuator {index + 1} jumps from {_bar(old)} to {_bar(new)}"
                expected = "a start at the current set-point; give this step lead_in_s, or put a ramp before it"
                yield "jump", jump, self._problem(segment, found, expected)
        yield from self._shared(segment)

    def _shared(self, segment: TrajectorySegment) -> Iterator[tuple[str, float, Problem]]:
        """Check that the set-points of actuators on one valve are equal."""
        for number, valve in enumerate(self.config.valves, start=1):
            if len(valve.actuators) < 2 or not set(valve.actuators) & set(segment.actuators):
                continue
            for t_s in _knots(segment):
                level = segment.level_at(segment.start_s + t_s)
                setpoints_pa = [level[actuator - 1] for actuator in valve.actuators]
                apart = max(setpoints_pa) - min(setpoints_pa)
                if apart > TINY_PA:
                    names = " and ".join(str(actuator) for actuator in valve.actuators)
                    found = f"{' and '.join(_bar(pa) for pa in setpoints_pa)} for actuators {names}"
                    expected = f"the same pressure: valves #{number}{self.rig} drives them together"
                    yield f"valve {number}", apart, self._problem(segment, found, expected)

    def _problem(self, segment: TrajectorySegment, value: str, expected: str) -> Problem:
        where, column = self.protocol.step_at(segment.line) if self.protocol else (segment.kind, 0)
        if not where.endswith(segment.label):
            where += f" ({segment.label})"
        return Problem(self.trajectory.source, segment.line, column, where, value, expected)


def _knots(segment: TrajectorySegment) -> tuple[float, ...]:
    """Return the times from the segment's start at which levels and rates are extreme."""
    duration_s = segment.stop_s - segment.start_s
    times = {t_s for _, wave in segment.waves for t_s in wave.knots(duration_s)}
    return tuple(sorted(times | {0.0, duration_s}))


def _extremes(segment: TrajectorySegment) -> list[tuple[float, float, float]]:
    """Return the lowest and highest level [Pa] and the steepest slope [Pa/s] of each actuator."""
    found = [(level, level, 0.0) for level in segment.level_pa]
    for index, wave in segment.waves:
        knots = np.array(wave.knots(segment.stop_s - segment.start_s))
        values, slopes = wave.values_at(knots), wave.slopes_at(knots)
        found[index] = (float(values.min()), float(values.max()), float(np.abs(slopes).max()))
    return found


def _bar(pa: float) -> str:
    return f"{pa / PA_PER_BAR:.4g} bar"
