"""What `rig check` names as possible for a path that it refuses: applied to the step, it is accepted."""

from __future__ import annotations

import copy
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import protocols
from protocols import BadInputError
from rig.config.loader import load
from rig.tip_planning.inverse import RigTipInverse

pytestmark = pytest.mark.slow

CENTRE = [0.0, 0.0, 190.0]
LETTER_N = [[-15.0, -20, 190], [-15, 20, 190], [15, -20, 190], [15, 20, 190]]
ZIGZAG = [
    [9.166, -30.885, 188.868], [32.753, 26.287, 189.047], [25.096, -13.275, 203.604], [17.069, -5.868, 187.804],
    [-34.406, 26.51, 182.872], [22.359, 32.354, 195.116], [-22.994, 25.745, 204.397],
]  # fmt: skip
LETTER_R = [
    [-12.0, -20, 188], [-12, 20, 188], [8, 20, 190], [14, 12, 192], [8, 2, 194], [-12, 2, 192], [14, -20, 188],
]  # fmt: skip
RADII = ("radius_mm", "width_mm", "height_mm")
Step = dict[str, Any]


@cache
def _inverse() -> RigTipInverse:
    return RigTipInverse(load("mock-3"))


def fault(step: Step, rows: list[list[float]], folder: Path) -> str:
    """What is expected in place of a step, with a CSV file of these rows; empty for an accepted step."""
    head = "time_s,x_mm,y_mm,z_mm" if len(rows[0]) == 4 else "x_mm,y_mm,z_mm"
    lines = [head, *(",".join(map(str, row)) for row in rows)]
    (folder / "path.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    steps = [{"hold": {"duration_s": 0.5}}, {"ramp": {"actuators": [1, 2, 3], "to_bar": 0.17, "duration_s": 1.5}}]
    try:
        protocols.from_steps("t", [*steps, {"tip": step}], folder=folder).expand(3, _inverse())
    except BadInputError as error:
        (problem,) = error.problems
        return problem.expected
    return ""


def remedied(step: Step, rows: list[list[float]], expected: str) -> Iterator[tuple[str, Step, list[list[float]]]]:
    """The step and its rows with each remedy that is named."""
    (shape,) = step.keys() & {"circle", "figure_eight", "star", "csv"}
    if longer := re.search(r"a lead_in_s of ([\d.]+)", expected):
        step = step | {"lead_in_s": float(longer[1])}
        if "is long enough" in expected:
            yield longer[0], step, rows
    timed = len(rows[0]) == 4
    if slower := re.search(r"([\d.]+) of this speed", expected):
        share, changed = float(slower[1]), copy.deepcopy(step)
        if "speed_mm_per_s" in step[shape]:
            changed[shape]["speed_mm_per_s"] *= share
        elif period := re.search(r"\(period_s: ([\d.e+]+)\)", expected):
            changed[shape]["period_s"] = float(period[1])
        yield slower[0], changed, [[row[0] / share, *row[1:]] for row in rows] if timed else rows
    if smaller := re.search(r"([\d.]+) of this size in the same time about", expected):
        share, changed = float(smaller[1]), copy.deepcopy(step)
        for name in {*RADII, "speed_mm_per_s"} & changed[shape].keys():
            changed[shape][name] *= share
        points = np.array(rows)
        at = points[:, -3:]
        middle = (at.max(axis=0) + at.min(axis=0)) / 2
        at[:] = middle + share * (at - middle)
        yield smaller[0], changed, points.tolist()


@pytest.mark.parametrize("lead_in_s", [0.2, 1.0, 3.0])
@pytest.mark.parametrize(
    ("shape", "rows"),
    [
        ({"circle": {"centre_mm": CENTRE, "radius_mm": 30.0, "period_s": 0.8, "periods": 2.5}}, LETTER_N),
        ({"circle": {"centre_mm": CENTRE, "radius_mm": 25.0, "speed_mm_per_s": 300.0, "periods": 2.0}}, LETTER_N),
        ({"star": {"centre_mm": CENTRE, "radius_mm": 40.0, "period_s": 1.5, "periods": 2.0}}, LETTER_N),
        ({"csv": {"file": "path.csv", "speed_mm_per_s": 110.0}}, LETTER_N),
        ({"csv": {"file": "path.csv", "speed_mm_per_s": 111.6}}, ZIGZAG),
        ({"csv": {"file": "path.csv"}}, [[0.25 * k, *point] for k, point in enumerate(LETTER_N)]),
    ],
    ids=["circle", "circle at a speed", "star", "letter", "zigzag", "letter with times"],
)
def test_what_is_named_as_possible_is_accepted(
    tmp_path: Path, shape: Step, rows: list[list[float]], lead_in_s: float
) -> None:
    step = shape | {"lead_in_s": lead_in_s}
    expected = fault(step, rows, tmp_path)
    named = list(remedied(step, rows, expected))
    assert named, expected
    assert expected.count(" of this ") == sum(" of this " in words for words, _, _ in named), expected
    for words, changed, changed_rows in named:
        assert fault(changed, changed_rows, tmp_path) == "", f"{words}: {expected}"


def test_a_lead_in_that_is_long_already_is_not_named_again(tmp_path: Path) -> None:
    step = {"csv": {"file": "path.csv", "speed_mm_per_s": 300.0}, "lead_in_s": 5.0}
    assert "lead_in_s" not in fault(step, LETTER_N, tmp_path)


def test_the_size_of_a_star_is_about_the_centre_that_its_step_states(tmp_path: Path) -> None:
    star = {"centre_mm": [-19.751, 12.57, 187.115], "normal": [-0.36, -0.008, 1.0], "radius_mm": 60.0}
    step = {"star": star | {"period_s": 3.065, "periods": 1.0}}
    expected = fault(step, LETTER_N, tmp_path)
    assert "in the same time about (x -19.75, y 12.57, z 187.12) mm" in expected
    ((words, changed, rows),) = remedied(step, LETTER_N, expected)
    assert fault(changed, rows, tmp_path) == "", f"{words}: {expected}"


def test_a_letter_with_sharp_corners_is_not_slowed_down_more_than_it_needs(tmp_path: Path) -> None:
    step: Step = {"csv": {"file": "path.csv", "speed_mm_per_s": 120.0}, "lead_in_s": 3.0}
    found = re.search(r"([\d.]+) of this speed", fault(step, LETTER_R, tmp_path))
    assert found is not None
    # 0.65 of it is accepted; at corners a grid as coarse as the path is slow would allow 0.18 only.
    assert float(found[1]) > 0.55
