"""`rig calibrate`: commands that are refused, with one clear message."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.command_line import invoke

CSV_HEAD = "point,X_mm,Y_mm,Z_mm,camera,u_px,v_px\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["camera", ".", "--square-mm", "25"], "--corners"),
        (["camera", ".", "--corners", "1x9", "--square-mm", "25"], "from 3x2"),
        (["camera", ".", "--corners", "9x6"], "--square-mm"),
        (["camera", "--corners", "9x6", "--square-mm", "25"], "--capture"),
        (["camera", ".", "--corners", "9x6", "--square-mm", "25", "--count", "9"], "it is of captured views"),
        (["camera", ".", "--corners", "9x6", "--square-mm", "25", "--seed", "9"], "it is of captured views"),
        (["camera", "--rig", "mock", "--capture", "--every", "2"], "it is of existing views"),
        (["camera", "a=x", "a=y", "--corners", "9x6", "--square-mm", "25"], "a name of its own"),
        (["dlt"], "control points"),
        (["camera", ".", "--corners", "9x6", "--square-mm", "25", "--to", "a.PNG"], "the picture goes beside it"),
        (["camera", ".", "--corners", "9x6", "--square-mm", "25", "--to", "."], "is a folder: name a file"),
        (["camera", ".", "--corners", "9x6", "--square-mm", "25", "--to", "kept.yaml"], "kept.png"),
        (["dlt", "points.csv", "--size", "640"], "640x480"),
        (["dlt", "points.csv", "--every", "2"], "it is of views of a board"),
        (["dlt", "points.csv", "--base", "0,0,0,0,0,0"], "it is of views of a board"),
        (
            ["dlt", "a=x", "b=y", "--corners", "9x6", "--square-mm", "25", "--size", "640x480"],
            "it is of control points (.csv)",
        ),
        (["dlt", "points.csv", "--size", "640x480", "--points-std-mm", "nan"], "--points-std-mm"),
        (["dlt", "a=x", "b=y", "--corners", "9x6", "--square-mm", "25", "--base", "0,nan,0,0,0,0"], "six numbers"),
        (["pressure", "--no-sensors", "--fast", "--yes", "--volume-ml", "0"], "more than 0"),
        (["pressure", "--no-sensors", "--fast", "--yes", "--volume-std-ml", "nan"], "more than 0"),
        (["tool"], "--straight"),
        (["pressure", "--readings", "nowhere.csv", "--no-valves"], "no such file"),
    ],
)
def test_an_invalid_command_gets_one_clear_message(here: Path, arguments: list[str], message: str) -> None:
    (here / "points.csv").write_text(CSV_HEAD + "1,0,0,0,a,1,2\n")
    (here / "kept.png").touch()
    done = invoke("calibrate", *arguments)
    assert done.exit_code == 2, done.output
    assert message in done.output
    assert "Traceback" not in done.output
