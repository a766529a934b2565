"""Steps that give a path of the tip: shapes, timing, lead-in, and what is wrong with them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import protocols
from protocols import BadInputError, Problem, SetPointTrajectory
from protocols.steps.tip import Circle, FigureEight, Points, Star, TipShape
from protocols.tip_inverse import TipRefusedError, TipRequest, TipSolution
from protocols.tip_paths import ScaledPath, TipPath, TipStart, fade, length_m

REST_M = np.array([0.0, 0.0, 0.17])


class ProportionalArm:
    """An inverse whose pressures are 1 bar per metre of the fade from rest."""

    def __init__(self) -> None:
        self.requests: list[TipRequest] = []

    def solve(self, request: TipRequest) -> TipSolution:
        self.requests.append(request)
        times = np.arange(0.0, request.lead_in_s + request.path.duration_s + 1e-9, 0.01)
        start = TipStart(REST_M, np.zeros(3))
        tips, _ = fade(start, request.path, request.lead_in_s, times - request.lead_in_s)
        return TipSolution(times, (tips - REST_M) * 1e5, tips, start)


class RefusingArm:
    def solve(self, request: TipRequest) -> TipSolution:
        raise TipRefusedError("a point", "another point")


def expanded(folder: Path, *steps: str, arm: ProportionalArm | RefusingArm | None = None) -> SetPointTrajectory:
    file = folder / "p.yaml"
    file.write_text("title: t\nsteps:\n" + "".join(f"  - {step}\n" for step in steps))
    return protocols.load(file).expand(3, arm or ProportionalArm())


def refused(folder: Path, *steps: str, arm: ProportionalArm | RefusingArm | None = None) -> Problem:
    with pytest.raises(BadInputError) as caught:
        expanded(folder, *steps, arm=arm)
    (problem,) = caught.value.problems
    return problem


CIRCLE = "{centre_mm: [0, 0, 190], radius_mm: 20, period_s: 2, periods: 3}"


def test_a_circle_has_its_radius_speed_and_sense() -> None:
    path = Circle(centre_mm=(1, 2, 190), radius_mm=20, speed_mm_per_s=10, periods=2).path(None)
    assert path.period_s == pytest.approx(4 * np.pi, rel=1e-6)
    t = np.linspace(0, path.duration_s, 50)
    off = path.positions_m(t) - [0.001, 0.002, 0.19]
    assert np.linalg.norm(off, axis=1) == pytest.approx(0.02)
    assert np.linalg.norm(path.velocities_m_s(t), axis=1) == pytest.approx(0.01)
    assert off[0] == pytest.approx([0.02, 0, 0])
    assert np.cross(off[0], path.velocities_m_s(t)[0])[2] > 0


def test_a_figure_eight_has_its_width_and_height_and_crosses_its_centre() -> None:
    path = FigureEight(centre_mm=(0, 0, 190), width_mm=30, height_mm=15, period_s=4, periods=1).path(None)
    points = path.positions_m(np.linspace(0, 4, 4001)) * 1e3
    assert np.ptp(points, axis=0) == pytest.approx([30, 15, 0], abs=1e-3)
    assert path.positions_m(np.array([0.0, 2.0, 4.0])) == pytest.approx(np.tile([0, 0, 0.19], (3, 1)))


def test_an_upright_plane_and_a_rotation_turn_the_shape() -> None:
    upright = Circle(centre_mm=(0, 0, 190), radius_mm=20, normal=(0, 1, 0), period_s=1, periods=1).path(None)
    assert np.ptp(upright.positions_m(np.linspace(0, 1, 401)), axis=0) == pytest.approx([0.04, 0, 0.04], abs=1e-5)
    turned = Circle(centre_mm=(0, 0, 190), radius_mm=20, rotation_deg=90, period_s=1, periods=1).path(None)
    assert turned.positions_m(np.zeros(1))[0] == pytest.approx([0, 0.02, 0.19])


SHAPES: list[TipShape] = [
    Circle(centre_mm=(0, 0, 190), radius_mm=20, period_s=2, periods=1.5),
    FigureEight(centre_mm=(0, 0, 190), width_mm=30, height_mm=15, period_s=2, duration_s=3, rotation_deg=20),
    Star(centre_mm=(0, 0, 190), radius_mm=20, period_s=5, periods=2),
    Points(at_mm=((0, 0, 190), (10, 0, 190), (0, 5, 180)), dwell_s=0.5, speed_mm_per_s=20),
    Points(at_mm=((0, 0, 190), (10, 0, 190), (0, 5, 180)), move_s=1, ways="linear", periods=2),
]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("scaled", [False, True])
def test_the_velocity_is_the_derivative_of_the_position(shape: TipShape, scaled: bool) -> None:
    path: TipPath = shape.path(None)
    if scaled:
        path = ScaledPath(path, 0.5, 0.7)
    start = TipStart(REST_M, np.array([0.01, 0.02, 0.0]))
    # Off the corners of linear ways.
    t = np.linspace(-1.9, path.duration_s, 777)[1:-1] + 1e-4
    slope = (fade(start, path, 2.0, t + 1e-6)[0] - fade(start, path, 2.0, t - 1e-6)[0]) / 2e-6
    assert fade(start, path, 2.0, t)[1] == pytest.approx(slope, abs=1e-6)


def test_points_are_held_for_their_dwell_and_periods_return_to_the_first() -> None:
    points = Points(at_mm=((0, 0, 190), (10, 0, 190)), dwell_s=1, move_s=0.5, periods=3).path(None)
    assert points.period_s == pytest.approx(3.0)
    at = points.positions_m(np.array([0.0, 1.0, 1.5, 2.5, 3.0, 9.0]))[:, 0]
    assert at == pytest.approx([0, 0, 0.01, 0.01, 0, 0])
    assert length_m(points) == pytest.approx(0.02)


def test_the_lead_in_begins_at_rest_and_meets_the_path_with_its_velocity() -> None:
    path = Circle(centre_mm=(0, 0, 190), radius_mm=20, period_s=2, periods=1).path(None)
    start = TipStart(REST_M, np.array([0.03, 0.0, 0.0]))
    position, velocity = fade(start, path, 3.0, np.array([-3.0, 0.0]))
    assert position[0] == pytest.approx(REST_M)
    assert velocity[0] == pytest.approx([0.03, 0, 0])
    assert position[1] == pytest.approx([0.02, 0, 0.19])
    assert velocity[1] == pytest.approx([0, 0.02 * np.pi, 0])


def test_the_trajectory_has_the_set_points_and_the_reference_of_the_path(tmp_path: Path) -> None:
    played = expanded(tmp_path, "hold: {duration_s: 1}", f"tip: {{circle: {CIRCLE}, lead_in_s: 2}}")
    assert played.duration_s == 9
    assert [segment.kind for segment in played.segments] == ["hold", "lead-in", "tip"]
    (motion,) = played.tip.motions
    assert (motion.start_s, motion.path_s, motion.stop_s, motion.line, motion.period_s) == (1, 3, 9, 4, 2)
    assert played.setpoint_pa(4.0) == pytest.approx((played.tip.position_m(4.0) - REST_M) * 1e5, abs=1)
    assert played.segments[-1].level_pa == pytest.approx((motion.position_m[-1] - REST_M) * 1e5, abs=1e-6)


def test_only_the_controlled_coordinates_have_a_reference(tmp_path: Path) -> None:
    played = expanded(tmp_path, f"tip: {{circle: {CIRCLE}, coordinates: [z, x]}}")
    assert played.tip.motions[0].coordinates == (0, 2)
    assert np.isnan(played.tip.position_m(1.0)).tolist() == [False, True, False]


def test_a_request_has_the_set_points_and_the_weight_before_it(tmp_path: Path) -> None:
    arm = ProportionalArm()
    ramp = "ramp: {actuators: [2], to_bar: 0.5, duration_s: 0.5}"
    expanded(tmp_path, "prompt: {message: hang, weight_g: 20}", ramp, f"tip: {{circle: {CIRCLE}}}", arm=arm)
    (request,) = arm.requests
    assert request.weight_kg == 0.02
    assert request.begin_s == pytest.approx(0.6)
    assert request.before_pa[-1] == pytest.approx([0, 50_000, 0])
    assert request.before_pa[-26] == pytest.approx([0, 25_000, 0])
    assert request.before_pa[0] == pytest.approx([0, 0, 0])


def test_a_csv_file_gives_points_over_time_or_at_a_speed(tmp_path: Path) -> None:
    (tmp_path / "timed.csv").write_text("time_s,x_mm,y_mm,z_mm\n5,0,0,190\n6,10,0,190\n8,10,20,190\n")
    (tmp_path / "plain.csv").write_text("x_mm,y_mm,z_mm\n0,0,190\n10,0,190\n10,20,190\n")
    timed = expanded(tmp_path, "tip: {csv: {file: timed.csv}, lead_in_s: 1}")
    assert timed.tip.position_m(1.5) == pytest.approx([0.005, 0, 0.19])
    assert timed.duration_s == pytest.approx(4)
    even = expanded(tmp_path, "tip: {csv: {file: plain.csv, speed_mm_per_s: 10}, lead_in_s: 1}")
    assert even.tip.position_m(3.0) == pytest.approx([0.01, 0.01, 0.19])
    assert even.duration_s == pytest.approx(4)


@pytest.mark.parametrize(
    ("body", "column", "where", "expected"),
    [
        ("{}", 5, "steps #1, tip", "needs one of circle, figure_eight, star, points, hold, csv"),
        (f"{{circle: {CIRCLE}, coordinates: [x, x]}}", 98, "steps #1, tip, coordinates", "x is named twice"),
        (f"{{circle: {CIRCLE}, tolerance_mm: 0}}", 99, "steps #1, tip, tolerance_mm", "above 0"),
        ("{circle: {centre_mm: [0, 0, 190], radius_mm: 20, periods: 3}}", 11, "steps #1, tip, circle", "period_s or"),
        ("{points: {at_mm: [[0, 0, 1], [0, 0, 1]], move_s: 1}}", 39, "steps #1, tip, points, at_mm #2", "another"),
        ("{csv: {file: missing.csv}}", 23, "steps #1, tip, csv, file", "there is no such file"),
        ("{hold: {at_mm: [0, 0, 190], duration_s: 5000}}", 10, "steps #1, tip", "at most 3600 s"),
        ("{hold: {at_mm: [0, 0, 190], duration_s: 1.0e-300}}", 10, "steps #1, tip", "at least 0.001 s"),
        (f"{{circle: {CIRCLE.replace('period_s: 2', 'period_s: 1.0e-9')}}}", 10, "steps #1, tip", "at least 0.001 s"),
        (
            f"{{circle: {CIRCLE.replace('period_s: 2', 'speed_mm_per_s: 9.0e+5')}}}",
            10,
            "steps #1, tip",
            "at least 0.001",
        ),
        (
            f"{{circle: {CIRCLE.replace('radius_mm: 20, period_s', 'radius_mm: 1.0e-300, speed_mm_per_s')}}}",
            10,
            "steps #1, tip",
            "a period of at least 0.001 s",
        ),
        (
            "{points: {at_mm: [[0, 0, 1], [0, 0, 2]], move_s: 1.0e-12, periods: 9}}",
            10,
            "steps #1, tip",
            "at least 0.001",
        ),
    ],
)
def test_a_wrong_path_is_refused_at_its_place(
    tmp_path: Path, body: str, column: int, where: str, expected: str
) -> None:
    problem = refused(tmp_path, f"tip: {body}")
    assert (problem.line, problem.column, problem.where) == (3, column, where)
    assert expected in problem.expected


def test_a_wrong_row_of_a_path_file_is_reported_with_line_and_column(tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text("time_s,x_mm,y_mm,z_mm\n0,0,0,190\n1,0,much,190\n0.5,0,0,190\n")
    with pytest.raises(BadInputError) as caught:
        expanded(tmp_path, "tip: {csv: {file: p.csv}}")
    first = caught.value.problems[0]
    assert (Path(first.file).name, first.line, first.column, first.where) == ("p.csv", 3, 5, "y_mm")
    assert "(mm)" in first.expected


def test_a_path_file_with_times_is_not_followed_at_a_speed(tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text("x_mm,y_mm,z_mm,time_s\n0,0,190,0\n10,0,190,1\n")
    with pytest.raises(BadInputError) as caught:
        expanded(tmp_path, "tip: {csv: {file: p.csv, speed_mm_per_s: 10}}")
    (problem,) = caught.value.problems
    assert (Path(problem.file).name, problem.line, problem.column, problem.value) == ("p.csv", 1, 16, "time_s")
    assert "a step without a speed" in problem.expected


@pytest.mark.parametrize(
    ("rows", "words", "line", "expected"),
    [
        ("0,0,190\n10,0,190\n10,20,190\n\n", "speed_mm_per_s: 20, periods: 2", 4, "the first row again, 0, 0, 190"),
        ("0,0,190\n0,0,190\n", "speed_mm_per_s: 20", 3, "another point than the others"),
    ],
    ids=["open path that repeats", "one point at a speed"],
)
def test_a_path_file_that_its_step_cannot_follow_is_reported_with_its_line(
    tmp_path: Path, rows: str, words: str, line: int, expected: str
) -> None:
    (tmp_path / "p.csv").write_text(f"x_mm,y_mm,z_mm\n{rows}")
    with pytest.raises(BadInputError) as caught:
        expanded(tmp_path, f"tip: {{csv: {{file: p.csv, {words}}}}}")
    (problem,) = caught.value.problems
    assert (Path(problem.file).name, problem.line) == ("p.csv", line)
    assert expected in problem.expected


def test_a_repeated_path_file_ends_where_it_begins(tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text("time_s,x_mm,y_mm,z_mm\n0,20,0,190\n1,0,20,190\n2,19.9999,0.0001,190\n")
    motion = expanded(tmp_path, "tip: {csv: {file: p.csv, periods: 2}}").tip.motions[0]
    assert motion.period_s == 2
    assert motion.position_m[-1].tolist() == [0.02, 0, 0.19]


def test_a_refusal_of_the_rig_is_reported_at_the_step(tmp_path: Path) -> None:
    problem = refused(tmp_path, "hold: {duration_s: 1}", f"tip: {{circle: {CIRCLE}}}", arm=RefusingArm())
    assert (problem.line, problem.column, problem.value, problem.expected) == (4, 10, "a point", "another point")


def test_without_a_rig_a_tip_path_has_no_set_points() -> None:
    with pytest.raises(BadInputError, match="need its arm"):
        protocols.load("tip-circle").expand(3)


def test_a_protocol_made_in_python_is_the_same_as_its_text(tmp_path: Path) -> None:
    corners = [[10, 10, 190], [-10, 10, 190], [-10, -10, 190]]
    step = {"points": {"at_mm": corners, "speed_mm_per_s": 10, "periods": 2}}
    made = protocols.from_steps("A triangle", [{"tip": step}, {"hold": {"duration_s": 1}}])
    (tmp_path / "saved.yaml").write_text(made.text)
    played, again = (p.expand(3, ProportionalArm()) for p in (made, protocols.load(tmp_path / "saved.yaml")))
    assert played.sample(np.linspace(0, 20, 50)).tolist() == again.sample(np.linspace(0, 20, 50)).tolist()
    with pytest.raises(BadInputError, match=r"steps\.yaml:3:"):
        protocols.from_steps("t", [{"tip": {"hold": {"at_mm": [0, 0], "duration_s": 1}}}])


def test_steps_may_hold_numpy_numbers_and_arrays() -> None:
    angle = np.linspace(0, np.pi, 5)
    points = np.stack([20 * np.cos(angle), 20 * np.sin(angle), np.full(5, 190.0)], axis=1)
    made, written = (
        protocols.from_steps("An arc", [{"tip": {"points": {"at_mm": at, "move_s": move_s}}}])
        for at, move_s in ((points, np.float64(0.5)), (points.tolist(), 0.5))
    )
    assert made.text == written.text
