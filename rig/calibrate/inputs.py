"""Inputs of the calibration commands: cameras with their pictures, boards, other calibrations."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from protocols import BadInputError
from protocols.problems import bad_input, closest
from rig.calibrate import file_sections
from rig.config import calibration_schema
from rig.config.board_sections import BoardPattern, CheckerboardPattern
from rig.config.calibration_files import LoadedCalibration, read
from rig.config.loader import load
from rig.config.schema import RigConfig

MOST_CORNERS = 99


@dataclass(frozen=True)
class CameraViews:
    """A camera's name and where its pictures are."""

    camera: str
    views: Path


def shown_board(corners: str, square_mm: float, rig: RigConfig | None) -> BoardPattern:
    """The board in the views: the checkerboard that the options state, else the rig's board."""
    if not corners and not square_mm and rig is not None and rig.board is not None:
        return rig.board
    across, down = corners_of(corners)
    return CheckerboardPattern(squares_x=across + 1, squares_y=down + 1, square_mm=checked_square(square_mm))


def corners_of(text: str) -> tuple[int, int]:
    """Inner corners of a board from a text such as 9x6."""
    columns, cross, rows = text.strip().lower().partition("x")
    if not (cross and columns.isdecimal() and rows.isdecimal() and len(columns) < 4 and len(rows) < 4):
        raise bad_input(
            "--corners", text, "inner corners across and down, as 9x6; or --rig alone, for the board of a rig"
        )
    counts = int(columns), int(rows)
    if not (min(counts) >= 2 and 3 <= max(counts) <= MOST_CORNERS):
        raise bad_input("--corners", text, f"from 3x2 to {MOST_CORNERS}x{MOST_CORNERS} inner corners")
    return counts


def checked_square(square_mm: float) -> float:
    """Edge of a square [mm]."""
    if not 0.01 <= square_mm <= 1e4:
        raise bad_input("--square-mm", f"{square_mm:g}", "the edge of one square in mm, 0.01 or more")
    return square_mm


def sources_of(arguments: list[str], rig: RigConfig | None, camera: str | None = None) -> tuple[CameraViews, ...]:
    """Cameras from arguments such as FOLDER or NAME=FOLDER; the default name is the folder's."""
    found = []
    for argument in arguments:
        name, equals, path = argument.partition("=")
        if not equals or Path(argument).exists():
            name, path = camera or "", argument
        views = Path(path)
        if not name:
            folder = views.parent if any(sign in views.name for sign in "*?[") else views
            name = (folder.resolve().stem if folder.is_file() else folder.resolve().name) or "camera"
        found.append(CameraViews(name, views))
    names = [source.camera for source in found]
    for name in names:
        if names.count(name) > 1:
            raise bad_input("NAME=FOLDER", name, "a name of its own for each camera")
        if rig is not None and (camera is not None or len(names) > 1):
            known_camera(rig, name)
    return tuple(found)


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


def rig_of(name: str | None) -> RigConfig | None:
    """The rig of that name or file, if one is given."""
    return None if name is None else load(name)


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
            raise BadInputError([one.problem(("kind",), one.found.kind, "camera: a file of `rig calibrate camera`")])
        name = one.found.camera.name
        if name in found:
            raise BadInputError([one.problem(("camera", "name"), name, "one calibration for each camera")])
        found[name] = one
    return found


def checked_size(one: LoadedCalibration, size: tuple[int, int], what: str) -> calibration_schema.CameraFile:
    """A camera's calibration, if it was made at this size of picture."""
    assert isinstance(one.found, calibration_schema.CameraFile)
    camera = one.found.camera
    for key, has, wants in (("width_px", camera.width_px, size[0]), ("height_px", camera.height_px, size[1])):
        if has != wants:
            expected = f"{wants}, as {what}: a calibration holds at its own resolution only"
            raise BadInputError([one.problem(("camera", key), has, expected)])
    return one.found
