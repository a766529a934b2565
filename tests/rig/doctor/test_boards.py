"""`rig doctor` says how large each camera sees the board, and when a picture cannot show it."""

from __future__ import annotations

from pathlib import Path

import pytest

from rig.config import loader
from rig.doctor.boards import rig_boards

MOCK = Path(__file__).parents[3] / "rig" / "rigs" / "mock.yaml"
CHECKERBOARD = "  squares_x: 7\n  squares_y: 6\n  square_mm: 8\n"
CHARUCO = "  kind: charuco\n  squares_x: 6\n  squares_y: 5\n  square_mm: 10\n  marker_mm: 7\n"
BOARD_PLACE = "placement: {translation_mm: [0, 0, 35], rotation_deg: [-60, 0, 0]}"
CAMERA_PLACE = "placement: {translation_mm: [0, 400, 200], rotation_deg: [90, 0, 0]}"


@pytest.mark.parametrize(
    ("old", "new", "verdict", "found"),
    [
        ("", "", "ok", "checkerboard of 30 corners, square 8 mm; 10.3 px for a square"),
        (CHECKERBOARD, CHARUCO, "note", "1.5 px for a cell of a marker"),
        (BOARD_PLACE, BOARD_PLACE.replace("-60", "120"), "missing", "sees its back"),
        (CAMERA_PLACE, CAMERA_PLACE.replace("[0, 400", "[200, 400"), "note", "of its corners are outside the picture"),
        (CAMERA_PLACE, CAMERA_PLACE.replace("[0, 400", "[300, 400"), "missing", "30 of its corners are outside"),
    ],
    ids=["resolved", "markers too small", "seen from behind", "partly outside", "outside"],
)
def test_the_doctor_says_how_a_camera_sees_the_board(
    tmp_path: Path, old: str, new: str, verdict: str, found: str
) -> None:
    text = MOCK.read_text()
    assert old in text
    (tmp_path / "bench.yaml").write_text(text.replace(old, new) if old else text)
    (finding,) = rig_boards(loader.load(str(tmp_path / "bench.yaml")))
    assert finding.topic == "board in camera front"
    assert found in finding.found
    assert finding.verdict == verdict
    assert bool(finding.remedy) == (verdict != "ok")


def test_each_camera_has_its_own_line_and_a_rig_without_a_board_none() -> None:
    assert [finding.topic for finding in rig_boards(loader.load("mock-stereo"))] == [
        "board in camera left",
        "board in camera right",
    ]
    assert rig_boards(loader.load("mock-no-camera")) == []
