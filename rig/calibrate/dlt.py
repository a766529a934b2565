"""Calibration of several cameras: DLT coefficients and poses, from control points or from views of a board."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.vision.transforms import RigidTransform
from protocols.problems import bad_input
from rig.calibrate import inputs
from rig.calibrate.dlt_boards import from_boards
from rig.calibrate.dlt_file import dlt_file
from rig.calibrate.dlt_fit import DLTCalibrationResult
from rig.calibrate.dlt_points import WIDEST_MM, from_points
from rig.calibrate.output_file import OutputFile
from rig.config import calibration_schema
from rig.config.calibration_files import sha256_of
from rig.config.drivers import CAMERA_DRIVERS
from rig.config.optics import rigid
from rig.config.sections import Placement

_WAYS = ("control points (.csv)", "views of a board")


@dataclass(frozen=True)
class DLTCalibrationRequest:
    """Options of the procedure, all as the command gives them."""

    given: tuple[str, ...]
    corners: str
    square_mm: float
    calibrations: tuple[Path, ...]
    rig: str | None
    size: str
    points_std_mm: float
    world_view: str
    base: str
    every: int
    output: OutputFile


@dataclass(frozen=True)
class DLTCalibration:
    """The result, the content of its file, where that is, and whether a camera is simulated."""

    result: DLTCalibrationResult
    content: calibration_schema.DLTFile
    file: Path
    simulated: bool


def run(request: DLTCalibrationRequest) -> DLTCalibration:
    """Calibrate, and write the file.

    Raises:
        BadInputError: the options, the control points or another calibration are invalid.
        ViewsError, CalibrationError, DLTError: the data do not determine the coefficients.
    """
    request.output.check()
    if not request.given:
        raise bad_input(
            "CSV|NAME=VIEWS", "", "a CSV of control points, or folders of simultaneous views for each camera"
        )
    is_csv = len(request.given) == 1 and request.given[0].lower().endswith((".csv", ".txt"))
    _refuse_of_other_input(request, is_csv)
    rig = inputs.rig_of(request.rig)
    known = inputs.camera_calibrations(list(request.calibrations))
    used = [
        calibration_schema.SourceFileSection(name=Path(one.source.file).name, sha256=one.sha256)
        for one in known.values()
    ]
    board = None
    if is_csv:
        csv = Path(request.given[0])
        result = from_points(csv, request.size, request.points_std_mm, rig, known)
        used.insert(0, calibration_schema.SourceFileSection(name=csv.name, sha256=sha256_of(csv)))
    else:
        board = inputs.shown_board(request.corners, request.square_mm, rig)
        result = from_boards(
            inputs.sources_of(list(request.given), rig),
            board.board(),
            rig,
            known,
            world_view=request.world_view,
            base=_base(request.base) if request.base else None,
            every=request.every,
        )
    in_base = is_csv or bool(request.base)
    content = dlt_file(result, rig, tuple(used), board, in_base=in_base, note=request.output.note)
    simulated = any(CAMERA_DRIVERS.simulates(camera.camera.driver) for camera in content.cameras)
    file = request.output.write(content, request.output.path("dlt"))
    return DLTCalibration(result, content, file, simulated)


def _refuse_of_other_input(request: DLTCalibrationRequest, from_points: bool) -> None:
    """Refuse options that apply only to the other form of input."""
    of_boards = {
        "--corners": request.corners,
        "--square-mm": request.square_mm,
        "--world-view": request.world_view,
        "--base": request.base,
        "--every": request.every if request.every > 1 else None,
    }
    of_points = {"--size": request.size, "--points-std-mm": request.points_std_mm}
    for option, value in (of_boards if from_points else of_points).items():
        if value:
            form, other = _WAYS if from_points else _WAYS[::-1]
            raise bad_input(option, str(value), f"no such option: it is of {other}, and {form} are given")


def _base(text: str) -> RigidTransform:
    """Return the pose of the world view's board in the rod-base frame."""
    parts = text.replace(" ", "").split(",")
    try:
        x, y, z, a, b, c = (float(part) for part in parts)
    except ValueError:
        x = y = z = a = b = c = np.inf
    if not all(abs(number) < WIDEST_MM for number in (x, y, z, a, b, c)):
        raise bad_input("--base", text, "six numbers X,Y,Z,A,B,C: mm, and a rotation vector in deg")
    return rigid(Placement(translation_mm=(x, y, z), rotation_deg=(a, b, c)))
