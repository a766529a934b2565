"""Inputs of the calibration commands: cameras with their pictures, boards, other calibrations, CSV files."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

from protocols import BadInputError, Problem, document
from protocols.problems import bad_input, closest
from rig.calibrate import file_sections
from rig.config import calibration_schema
from rig.config.board_sections import BoardPattern, CheckerboardPattern
from rig.config.calibration_files import LoadedCalibration, read
from rig.config.schema import RigConfig

MOST_CORNERS = 99
LARGEST_CSV = 20_000_000


def shown_board(corners: str, square_mm: float, rig: RigConfig | None) -> BoardPattern:
    """The board in the views: the checkerboard with inner corners such as 9x6, else the rig's board."""
    if not corners and not square_mm and rig is not None and rig.board is not None:
        return rig.board
    columns, cross, rows = corners.strip().lower().partition("x")
    if not (cross and columns.isdecimal() and rows.isdecimal() and len(columns) < 4 and len(rows) < 4):
        expected = "inner corners across and down, as 9x6; or --rig alone, for the board of a rig"
        raise bad_input("--corners", corners, expected)
    across, down = int(columns), int(rows)
    if not (min(across, down) >= 2 and 3 <= max(across, down) <= MOST_CORNERS):
        raise bad_input("--corners", corners, f"from 3x2 to {MOST_CORNERS}x{MOST_CORNERS} inner corners")
    if not 0.01 <= square_mm <= 1e4:
        raise bad_input("--square-mm", f"{square_mm:g}", "the edge of one square in mm, 0.01 or more")
    return CheckerboardPattern(squares_x=across + 1, squares_y=down + 1, square_mm=square_mm)


def sources_of(arguments: Sequence[str], rig: RigConfig | None, camera: str | None = None) -> dict[str, Path]:
    """Where the pictures of each camera are, from arguments such as FOLDER or NAME=FOLDER; the default name is the
    folder's.
    """
    found: dict[str, Path] = {}
    for argument in arguments:
        name, equals, path = argument.partition("=")
        if not equals or Path(argument).exists():
            name, path = camera or "", argument
        views = Path(path)
        if not name:
            folder = views.parent if any(sign in views.name for sign in "*?[") else views
            name = (folder.resolve().stem if folder.is_file() else folder.resolve().name) or "camera"
        if name in found:
            raise bad_input("NAME=FOLDER", name, "a name of its own for each camera")
        found[name] = views
    if rig is not None and (camera is not None or len(found) > 1):
        for name in found:
            known_camera(rig, name)
    return found


def known_camera(rig: RigConfig, name: str | None) -> str:
    """The name, if the rig has such a camera; without a name the first camera."""
    if not rig.cameras:
        raise bad_input("--rig", rig.name, "a rig with a camera: this one has none")
    if not name:
        return next(iter(rig.cameras))
    if name not in rig.cameras:
        raise bad_input(
            "--camera", name, f"a camera of rig {rig.name}: {', '.join(rig.cameras)}", closest(name, rig.cameras)
        )
    return name


def identity(rig: RigConfig | None, name: str, size: tuple[int, int]) -> calibration_schema.CameraIdentity:
    """Return the identity of a camera; refuse pictures of another size (width, height) than the rig's."""
    if rig is None or name not in rig.cameras:
        return calibration_schema.CameraIdentity(name=name, width_px=size[0], height_px=size[1])
    camera = rig.cameras[name]
    if (camera.width_px, camera.height_px) != size:
        raise bad_input(
            "the views",
            f"{size[0]}x{size[1]}",
            f"{camera.width_px}x{camera.height_px}, as camera {name} of rig {rig.name}: a calibration holds at its own "
            "resolution only",
        )
    return file_sections.identity_of(rig, name)


def camera_calibrations(paths: list[Path]) -> dict[str, LoadedCalibration]:
    """Files of `rig calibrate camera`, by the camera's name."""
    found: dict[str, LoadedCalibration] = {}
    for path in paths:
        one = read(path)
        if not isinstance(one.found, calibration_schema.CameraFile):
            raise BadInputError([one.source.problem(("kind",), "camera: a file of `rig calibrate camera`")])
        name = one.found.camera.name
        if name in found:
            raise BadInputError([one.source.problem(("camera", "name"), "one calibration for each camera")])
        found[name] = one
    return found


def checked_size(one: LoadedCalibration, size: tuple[int, int], what: str) -> calibration_schema.CameraFile:
    """A camera's calibration, if it was made at this size of picture."""
    assert isinstance(one.found, calibration_schema.CameraFile)
    camera = one.found.camera
    for key, has, wants in (("width_px", camera.width_px, size[0]), ("height_px", camera.height_px, size[1])):
        if has != wants:
            expected = f"{wants}, as {what}: a calibration holds at its own resolution only"
            raise BadInputError([one.source.problem(("camera", key), expected)])
    return one.found


def table(path: Path, columns: tuple[str, ...]) -> list[tuple[int, dict[str, str]]]:
    """Rows of a CSV by line, each with the named columns; `BadInput` where one is missing or there are no rows."""
    reader = csv.reader(document.read_text(path, LARGEST_CSV).splitlines())
    try:
        rows = [(reader.line_num, row) for row in reader if row and not row[0].lstrip().startswith("#")]
    except csv.Error as fault:
        expected = f"a line of CSV ({fault})"
        raise BadInputError([Problem(str(path), reader.line_num, 0, "", "", expected)]) from None
    if not rows:
        raise bad_input(str(path), "", f"the file is empty: a header {','.join(columns)} and rows")
    line, header = rows[0]
    header = [name.strip() for name in header]
    missing = [name for name in columns if name not in header]
    if missing:
        meant = closest(missing[0], header)
        raise BadInputError(
            [Problem(str(path), line, 0, "header", ",".join(header), f"the columns {','.join(columns)}",
                     f"{missing[0]} for {meant}" if meant else "")]
        )  # fmt: skip
    if len(rows) == 1:
        raise BadInputError([Problem(str(path), line, 0, "", "", "rows below the header: there are none")])
    found = []
    for number_, row in rows[1:]:
        if len(row) != len(header):
            raise BadInputError(
                [Problem(str(path), number_, 0, "", f"{len(row)} cells", f"{len(header)} cells, as the header has")]
            )
        cells = dict(zip(header, (cell.strip() for cell in row), strict=True))
        found.append((number_, {name: cells[name] for name in columns}))
    return found


def number(path: Path, line: int, column: str, text: str, problems: list[Problem]) -> float:
    """A cell as a number; NaN, and a problem, where it is none."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        problems.append(Problem(str(path), line, 0, column, text or "nothing", "a plain number"))
        return math.nan
    return value
