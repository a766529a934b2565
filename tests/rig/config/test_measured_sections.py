"""Boards along the arm in the rig file: bad values and combinations have one clear message each."""

from __future__ import annotations

import pytest

from protocols import BadInputError
from rig.config import loader
from tests.support.sectioned_bench import sectioned, sectioned_rig


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("at_mm: 125", "at_mm: 170", "less than the length of the arm, 170 mm"),
        ("at_mm: 125", "at_mm: 85.0", "another place: section middle is there too"),
        ("first_marker: 20", "first_marker: 14", "markers of its own: board has numbers 0 to 14 of 4X4_50"),
        (
            "      kind: apriltag\n      tags_x: 3\n      tags_y: 1\n      tag_mm: 12\n      gap_mm: 3\n",
            "      squares_x: 5\n      squares_y: 4\n      square_mm: 8\n",
            "charuco or apriltag: markers distinguish several boards",
        ),
    ],
)
def test_a_fault_of_a_section_has_a_clear_message(old: str, new: str, expected: str) -> None:
    text = sectioned(loader.text("mock-charuco"))
    assert text.count(old) == 1
    with pytest.raises(BadInputError) as bad:
        loader.parse(text.replace(old, new), "rig.yaml")
    (problem,) = bad.value.problems
    assert expected in problem.expected, problem


def test_the_board_on_the_cap_needs_markers_beside_others() -> None:
    with pytest.raises(BadInputError) as bad:
        loader.parse(sectioned(loader.text("mock")), "rig.yaml")
    (problem,) = bad.value.problems
    assert "markers distinguish several boards" in problem.expected


def test_a_rig_without_a_board_has_no_sections() -> None:
    with pytest.raises(BadInputError) as bad:
        loader.parse(sectioned(loader.text("mock-no-camera")), "rig.yaml")
    assert any("without a board on the end cap" in problem.expected for problem in bad.value.problems)


def test_boards_of_one_family_with_other_numbers_and_of_other_families_are_accepted() -> None:
    config = sectioned_rig()
    assert [config.sections[name].board.markers for name in config.sections] == [
        ("APRILTAG_36h11", range(3)),
        ("4X4_50", range(20, 27)),
    ]
