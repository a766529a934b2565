"""Consistency of the boards along the arm with each other, with the board on the end cap and with the arm."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from protocols.validation import ValidationFault

if TYPE_CHECKING:
    from rig.config.board_sections import BoardConfig, MeasuredSection
    from rig.config.sections import ArmConfig


def check(
    board: BoardConfig | None, sections: Mapping[str, MeasuredSection | None], arm: ArmConfig
) -> Iterator[ValidationFault]:
    """Yield what is wrong with the sections: the boards of a rig have different markers."""
    known = {name: section for name, section in sections.items() if section is not None}
    if not known:
        return
    if board is None:
        yield ValidationFault(("sections",), "no such section in a rig without a board on the end cap")
        return
    boards: dict[tuple[str | int, ...], BoardConfig] = {("board",): board}
    length_mm, places = arm.geometry.length_mm, dict[float, str]()
    for name, section in known.items():
        if section.at_mm >= length_mm:
            expected = f"less than the length of the arm, {length_mm:g} mm"
            yield ValidationFault(("sections", name, "at_mm"), expected)
        if (taken_by := places.setdefault(section.at_mm, name)) != name:
            expected = f"another place: section {taken_by} is there too; two boards on one section measure the same"
            yield ValidationFault(("sections", name, "at_mm"), expected)
        boards["sections", name, "board"] = section.board
    seen: list[tuple[str, BoardConfig]] = []
    for path, one in boards.items():
        family, numbers = one.markers
        if not numbers:
            expected = "charuco or apriltag: markers distinguish several boards"
            yield ValidationFault((*path, "kind"), expected)
            continue
        for other_name, other in seen:
            other_family, others = other.markers
            if family == other_family and max(numbers[0], others[0]) <= min(numbers[-1], others[-1]):
                expected = f"markers of its own: {other_name} has numbers {others[0]} to {others[-1]} of {family}"
                yield ValidationFault((*path, "first_marker"), expected)
                break
        seen.append((", ".join(map(str, path)), one))
