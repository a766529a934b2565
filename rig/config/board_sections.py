"""The kinds of board that a rig file and a calibration file can name; one line here registers a kind."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from calibration.vision.marker_families import MARKERS, MarkerFamily
from protocols.validation import ValidationFault, faults
from rig.config.sections import Placement
from rig.sections.base import Section
from rig.sections.plugins import PluginSections, SectionRegistry, uninstalled
from rig.sections.quantities import Index, LengthMm

if TYPE_CHECKING:
    from calibration.vision.board import Board

Squares = Annotated[int, Field(ge=3, le=100, strict=True)]
Tags = Annotated[int, Field(ge=1, le=100, strict=True)]

# The white around a marker, as a share of the square or the tag: with less its rim runs into what is beside it.
_LEAST_WHITE = 0.05
_DEFAULT_KIND = "checkerboard"


class BoardPattern(Section):
    """What is printed."""

    kind: str

    @abstractmethod
    def board(self) -> Board:
        """The board, in SI units."""

    @property
    @abstractmethod
    def corner_count(self) -> int:
        """How many corners it has."""

    @property
    @abstractmethod
    def lengths_mm(self) -> dict[str, float]:
        """What was measured on the print, by name."""

    @property
    def pattern(self) -> BoardPattern:
        """The print alone, as calibration files state it."""
        return self

    @property
    def markers(self) -> tuple[str, range]:
        """Family and numbers of the markers; no numbers for a board without."""
        return "", range(0)

    @property
    def marker_texts(self) -> tuple[str, ...]:
        """Family and numbers of the markers in words; nothing for a board without."""
        family, numbers = self.markers
        if not numbers:
            return ()
        if len(numbers) == 1:
            return (f"marker {family}, number {numbers[0]}",)
        return (f"markers {family}, numbers {numbers[0]} to {numbers[-1]}, row by row from the top left",)

    @property
    def words(self) -> str:
        """The board in a few words."""
        lengths = ", ".join(f"{name} {value:g} mm" for name, value in self.lengths_mm.items())
        return f"{self.kind} of {self.corner_count} corners, {lengths}"


class BoardConfig(BoardPattern):
    """The board on the end cap. `placement` is the board (origin at its centre, z out of the print) in the tip frame:
    origin at the rod's tip, axes as the rod base's when the rod is straight.
    """

    placement: Placement

    @classmethod
    def print_kind(cls) -> type[BoardPattern]:
        """The class of the print alone."""
        return next(one for one in cls.__mro__ if issubclass(one, BoardPattern) and not issubclass(one, BoardConfig))

    @property
    def pattern(self) -> BoardPattern:
        kind = self.print_kind()
        return kind.model_validate(self.model_dump(include=set(kind.model_fields)))


class SquaresPattern(BoardPattern):
    """A pattern of squares, dark and white in turn."""

    squares_x: Squares
    squares_y: Squares
    square_mm: LengthMm

    @property
    def corner_count(self) -> int:
        return (self.squares_x - 1) * (self.squares_y - 1)


class CheckerboardPattern(SquaresPattern):
    """Any checkerboard."""

    kind: Literal["checkerboard"] = "checkerboard"

    def board(self) -> Board:
        from calibration.vision.checkerboard import Checkerboard

        return Checkerboard(self.squares_x, self.squares_y, self.square_mm * 1e-3)

    @property
    def lengths_mm(self) -> dict[str, float]:
        return {"square": self.square_mm}


class CheckerboardConfig(CheckerboardPattern, BoardConfig):
    """The checkerboard on the end cap; the square at the top left is dark."""

    @model_validator(mode="after")
    def _odd_by_even(self) -> CheckerboardConfig:
        if (self.squares_x + self.squares_y) % 2 == 0:
            faults([ValidationFault(("squares_y",), "an odd number of squares one way and an even number the other")])
        return self


class CharucoPattern(SquaresPattern):
    """A checkerboard with a marker in every white square; the square at the top left is dark."""

    kind: Literal["charuco"]
    marker_mm: LengthMm
    dictionary: MarkerFamily = "4X4_50"
    first_marker: Index = 0

    def board(self) -> Board:
        from calibration.vision.charuco import CharucoBoard

        return CharucoBoard(
            self.squares_x,
            self.squares_y,
            self.square_mm * 1e-3,
            self.marker_mm * 1e-3,
            self.dictionary,
            self.first_marker,
        )

    @property
    def lengths_mm(self) -> dict[str, float]:
        """The edges of a square and of a marker."""
        return {"square": self.square_mm, "marker": self.marker_mm}

    @property
    def markers(self) -> tuple[str, range]:
        return self.dictionary, range(self.first_marker, self.first_marker + self.squares_x * self.squares_y // 2)

    @model_validator(mode="after")
    def _fits(self) -> CharucoPattern:
        largest = (1 - 2 * _LEAST_WHITE) * self.square_mm
        if self.marker_mm > largest:
            expected = f"at most {largest:g} mm: a square of {self.square_mm:g} mm needs white around its marker"
            faults([ValidationFault(("marker_mm",), expected)])
        _enough_markers(self.squares_x * self.squares_y // 2, self.first_marker, self.dictionary)
        return self


class CharucoConfig(CharucoPattern, BoardConfig):
    """The ChArUco board on the end cap."""


class TagGridPattern(BoardPattern):
    """A grid of AprilTag or ArUco markers, `gap_mm` apart and as far from whatever is beside them."""

    kind: Literal["apriltag"]
    tags_x: Tags
    tags_y: Tags
    tag_mm: LengthMm
    gap_mm: LengthMm
    dictionary: MarkerFamily = "APRILTAG_36h11"
    first_marker: Index = 0

    def board(self) -> Board:
        from calibration.vision.tag_grid import TagGrid

        return TagGrid(
            self.tags_x, self.tags_y, self.tag_mm * 1e-3, self.gap_mm * 1e-3, self.dictionary, self.first_marker
        )

    @property
    def corner_count(self) -> int:
        return 4 * self.tags_x * self.tags_y

    @property
    def lengths_mm(self) -> dict[str, float]:
        """The edge of a tag and the gap between two."""
        return {"tag": self.tag_mm, "gap": self.gap_mm}

    @property
    def markers(self) -> tuple[str, range]:
        return self.dictionary, range(self.first_marker, self.first_marker + self.tags_x * self.tags_y)

    @model_validator(mode="after")
    def _fits(self) -> TagGridPattern:
        least = _LEAST_WHITE * self.tag_mm
        if self.gap_mm < least:
            faults([ValidationFault(("gap_mm",), f"at least {least:g} mm: a tag of {self.tag_mm:g} mm needs white")])
        _enough_markers(self.tags_x * self.tags_y, self.first_marker, self.dictionary)
        return self


class TagGridConfig(TagGridPattern, BoardConfig):
    """The grid of tags on the end cap."""


BOARDS = SectionRegistry[BoardConfig]("boards", "kind", BoardConfig, CheckerboardConfig, CharucoConfig, TagGridConfig)


def with_default_kind(value: Any) -> Any:
    """A board without `kind` is a checkerboard."""
    return {"kind": _DEFAULT_KIND, **value} if isinstance(value, dict) and "kind" not in value else value


def _enough_markers(needed: int, first: int, family: str) -> None:
    """Refuse a board that needs more markers than its family has."""
    if first + needed > MARKERS[family]:
        expected = f"a family of at least {first + needed} markers: {family} has {MARKERS[family]}"
        faults([ValidationFault(("dictionary",), expected)])


if TYPE_CHECKING:
    AnyBoard = BoardConfig
    AnyPattern = BoardPattern
else:
    _default = BeforeValidator(with_default_kind)
    AnyBoard = Annotated[BOARDS.section(), _default]
    """The board of the rig file."""
    _print_alone = PluginSections(
        BOARDS, "kind", BoardPattern, lambda board: board.print_kind(), uninstalled(BoardPattern, "kind")
    )
    AnyPattern = Annotated[_print_alone.section, _default]
    """The board of a calibration file."""


class MeasuredSection(Section):
    """A cross-section of the arm that carries a board of its own: its pose is measured beside that of the tip.

    The board's `placement` is that in the frame of the section: origin on the arm's axis at `at_mm`, axes as the rod
    base's when the rod is straight.
    """

    at_mm: LengthMm = Field(description="arc length from the rod base to the section, of the arm at rest")
    board: AnyBoard
