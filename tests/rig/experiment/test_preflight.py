"""The second stage: a trajectory against the rig that shall play it."""

from __future__ import annotations

from pathlib import Path

import pytest

import protocols
from protocols import Problem, SetPointTrajectory, TrajectorySegment
from protocols.waveforms import LinearSegment
from rig.config.loader import load
from rig.experiment.preflight import check, peak_pa
from rig.tip_planning.inverse import RigTipInverse

RIG = load("mock")
RIG = RIG.model_copy(update={"limits": RIG.limits.model_copy(update={
    "pressure_bar": 0.7, "rate_bar_per_s": 1.0, "duration_s": 3600.0}
)})  # fmt: skip


def checked(folder: Path, *steps: str) -> tuple[Problem, ...]:
    file = folder / "p.yaml"
    file.write_text("title: t\nsteps:\n" + "".join(f"  - {step}\n" for step in steps))
    protocol = protocols.load(file)
    return check(RIG, protocol.expand(RIG.actuators), protocol, Path("rigs/bench.yaml"))


IN_SPACE = ("tip-circle", "tip-eight", "tip-points")
"""Protocols that need three valves."""
OF_SIX_CHAMBERS = "two-sections"
WITH_TWO_VALVES = [name for name, _ in protocols.named() if name not in (*IN_SPACE, OF_SIX_CHAMBERS)]


@pytest.mark.parametrize(
    ("name", "rig"),
    [
        *((name, rig) for name in WITH_TWO_VALVES for rig in ("mock", "pci1716")),
        *((name, rig) for name in IN_SPACE for rig in ("mock-3", "pci1716-2")),
        (OF_SIX_CHAMBERS, "mock-two-sections"),
    ],
)
def test_every_named_protocol_runs_on_the_named_rigs(name: str, rig: str) -> None:
    config = load(rig)
    assert check(config, protocols.load(name).expand(config.actuators, RigTipInverse(config))) == ()


@pytest.mark.parametrize(
    ("step", "found", "expected"),
    [
        ("staircase: {actuators: [1], start_bar: 0.5, stop_bar: 0.9, step_bar: 0.1, dwell_s: 1}",
         "actuator 1 at 0.9 bar", "at most 0.7 bar (limits, pressure_bar in bench.yaml)"),
        ("sine: {actuators: [1], mean_bar: 0.5, amplitude_bar: 0.3, omega_rad_s: 1, periods: 9, lead_in_s: 4}",
         "actuator 1 at 0.8 bar", "at most 0.7 bar"),
        ("ramp: {actuators: [1], to_bar: 0.5, duration_s: 0.25}",
         "actuator 1 at 2 bar/s", "at most 1 bar/s (limits, rate_bar_per_s in bench.yaml)"),
        ("ramp: {actuators: [1], to_bar: 0.5, duration_s: 0.5, shape: smooth}",
         "actuator 1 at 1.875 bar/s", "at most 1 bar/s"),
        ("sine: {actuators: [1], mean_bar: 0.3, amplitude_bar: 0.25, omega_rad_s: 8, periods: 9, lead_in_s: 4}",
         "actuator 1 at 2 bar/s", "at most 1 bar/s"),
        ("sine: {actuators: [1], mean_bar: 0.1, amplitude_bar: 0.2, omega_rad_s: 1, periods: 1, lead_in_s: 4}",
         "actuator 1 at -0.1 bar", "at least 0 bar (limits, lowest_pressure_bar in bench.yaml)"),
        ("sine: {actuators: [1], mean_bar: 0.3, amplitude_bar: 0.1, omega_rad_s: 1, periods: 1}",
         "actuator 1 jumps from 0 bar to 0.3 bar", "lead_in_s"),
        ("ramp: {actuators: [2], to_bar: 0.5, duration_s: 5}",
         "0.5 bar and 0 bar for actuators 2 and 3", "the same pressure: valves #2 in bench.yaml"),
        ("sine: {actuators: [2, 3], mean_bar: 0.3, amplitude_bar: 0.1, omega_rad_s: 1, periods: 2, lead_in_s: 4, "
         "phase_deg: [0, 180]}", "for actuators 2 and 3", "the same pressure"),
    ],
)  # fmt: skip
def test_a_violation_points_to_the_line_of_its_step(tmp_path: Path, step: str, found: str, expected: str) -> None:
    problems = checked(tmp_path, "hold: {duration_s: 1}", step)
    assert all((problem.line, problem.column) == (4, 5) for problem in problems)
    assert all(problem.file == str(tmp_path / "p.yaml") for problem in problems)
    assert any(found in problem.value and expected in problem.expected for problem in problems)


def test_a_set_point_below_the_atmosphere_is_refused_in_every_trajectory() -> None:
    dips = ((0, LinearSegment(0.0, -2000.0, 1.0)),)
    segment = TrajectorySegment(0.0, 1.0, "ramp", "down", (1,), 7, (-2000.0, 0.0, 0.0), dips)
    (problem,) = check(RIG, SetPointTrajectory(1.0, 3, (segment,), (), "made.py"))
    assert (problem.line, problem.value) == (7, "actuator 1 at -0.02 bar")
    assert problem.expected == "at least 0 bar (limits, lowest_pressure_bar)"


def test_a_step_is_reported_once_for_each_rule_however_often_it_repeats(tmp_path: Path) -> None:
    stairs = "staircase: {actuators: [1], start_bar: 0.75, stop_bar: 0.9, step_bar: 0.05, dwell_s: 1}"
    (problem,) = checked(tmp_path, f"repeat: {{times: 5, steps: [{{{stairs}}}]}}")
    assert problem.value == "actuator 1 at 0.9 bar"
    assert problem.where == "steps #1, repeat, steps #1, staircase (0.9 bar)"


def test_a_step_that_starts_where_another_has_gone_too_far_is_not_reported(tmp_path: Path) -> None:
    found = checked(
        tmp_path,
        "ramp: {actuators: [1], to_bar: 0.9, duration_s: 5}",
        "hold: {duration_s: 1}",
        "ramp: {actuators: [1], to_bar: 0, duration_s: 5}",
        "staircase: {actuators: [2, 3], start_bar: 0.1, stop_bar: 0.9, step_bar: 0.1, dwell_s: 4}",
        "ramp: {actuators: [2, 3], to_bar: 0.85, duration_s: 5}",
        "ramp: {actuators: [2, 3], to_bar: 0, duration_s: 5}",
    )
    assert [(problem.line, problem.value) for problem in found] == [
        (3, "actuator 1 at 0.9 bar"),
        (6, "actuator 2 at 0.9 bar"),
        (7, "actuator 2 at 0.9 bar"),
    ]


def test_a_step_of_the_set_point_is_accepted(tmp_path: Path) -> None:
    assert checked(tmp_path, "hold: {actuators: [1], level_bar: 0.6, duration_s: 1}") == ()


def test_a_jump_that_the_tracking_interlock_would_end_is_refused(tmp_path: Path) -> None:
    config = load("mock")
    slow = config.model_copy(update={"limits": config.limits.model_copy(update={"rate_bar_per_s": 0.3})})
    file = tmp_path / "p.yaml"
    file.write_text("title: t\nsteps:\n  - hold: {actuators: [1], level_bar: 0.5, duration_s: 3}\n")
    protocol = protocols.load(file)
    (problem,) = check(slow, protocol.expand(slow.actuators), protocol, Path("rigs/bench.yaml"))
    assert (problem.line, problem.value) == (3, "actuator 1 jumps from 0 bar to 0.5 bar")
    assert "at most 0.35 bar, which 0.3 bar/s permits within 1 s" in problem.expected
    assert check(config, protocol.expand(config.actuators), protocol) == ()


def test_a_protocol_that_takes_too_long_is_refused(tmp_path: Path) -> None:
    (problem,) = checked(tmp_path, "hold: {duration_s: 4000}")
    assert (problem.value, problem.where) == ("4000 s", "the whole protocol")


def test_a_trajectory_for_another_number_of_actuators_is_refused() -> None:
    (problem,) = check(RIG, protocols.load("ramp-a").expand(1))
    assert problem.expected == "a trajectory for the 3 actuators of the rig"


def test_the_peak_is_found_however_brief_it_is(tmp_path: Path) -> None:
    (tmp_path / "pulse.csv").write_text("time_s,actuator_2_bar\n0,0.1\n3000.0011,0.1\n3000.0012,0.5\n3000.0013,0.1\n")
    (tmp_path / "p.yaml").write_text("title: t\nsteps:\n  - csv: {file: pulse.csv, actuators: [2], lead_in_s: 1}\n")
    assert peak_pa(protocols.load(tmp_path / "p.yaml").expand(3)) == pytest.approx([0, 0.5e5, 0])
