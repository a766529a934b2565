"""Calibration of several cameras: DLT coefficients and poses, from control points or from views of a board."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calibration.cross_validation import CrossValidation
from calibration.vision.transforms import RigidTransform
from model.units import MM_PER_M
from protocols.problems import bad_input
from rig.calibrate import file_sections, inputs
from rig.calibrate.dlt_boards import from_boards
from rig.calibrate.dlt_fit import DLTCalibrationResult
from rig.calibrate.dlt_points import WIDEST_MM, from_points
from rig.calibrate.file_sections import OutputFile
from rig.config import calibration_schema
from rig.config.board_sections import BoardPattern
from rig.config.calibration_files import rounded, sha256_of
from rig.config.drivers import Reality
from rig.config.loader import load
from rig.config.optics import placement_of, rigid
from rig.config.schema import RigConfig
from rig.config.sections import CAMERA_DRIVERS, Placement

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
    rig = None if request.rig is None else load(request.rig)
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
            inputs.sources_of(request.given, rig),
            board.board(),
            rig,
            known,
            world_view=request.world_view,
            base=_base(request.base) if request.base else None,
            every=request.every,
        )
    in_base = is_csv or bool(request.base)
    content = dlt_file(result, rig, tuple(used), board, in_base=in_base, note=request.output.note)
    simulated = any(CAMERA_DRIVERS.reality(camera.camera.driver) is not Reality.REAL for camera in content.cameras)
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


def _points(names: tuple[str, ...], corners: int) -> tuple[str, ...]:
    """Names of control points; or of views, if each shows all `corners` of the board."""
    views = tuple(dict.fromkeys(name.rpartition(":")[0] for name in names))
    return views if len(names) == corners * len(views) else names


def _section(
    name: str, result: DLTCalibrationResult, identity: calibration_schema.CameraIdentity, corners: int
) -> calibration_schema.DLTCamera:
    dlt, observation = result.dlts[name], result.observations[name]
    place, covariance = result.places[name]
    # World in mm: what multiplies a coordinate is a thousand times smaller.
    scale = np.where(np.isin(np.arange(11), (3, 7)), 1.0, 1 / MM_PER_M)
    units = np.array([MM_PER_M] * 3 + [np.rad2deg(1)] * 3)
    spread = covariance * np.outer(units, units)
    known = bool(np.all(np.isfinite(spread)))
    std = np.sqrt(np.diag(spread)) if known else np.zeros(6)
    placement = placement_of(
        replace(place, translation_std_m=float(np.sqrt(np.mean(std[:3] ** 2))) / MM_PER_M,
                rotation_std_rad=float(np.deg2rad(np.sqrt(np.mean(std[3:] ** 2)))))
    )  # fmt: skip
    return calibration_schema.DLTCamera(
        camera=identity,
        lens=None if observation.lens is None else file_sections.lens_section(observation.lens),
        coefficients_px_mm=rounded(dlt.coefficients * scale, 10),
        covariance=file_sections.matrix(dlt.covariance * np.outer(scale, scale)),
        rms_px=rounded(dlt.rms_px),
        placement=placement,
        placement_covariance=file_sections.matrix(spread if known else np.zeros((6, 6))),
        placement_known=known,
        points=_points(observation.names, corners),
        residuals_px=rounded(dlt.residuals_px.ravel(), 3),
    )


def dlt_file(
    result: DLTCalibrationResult,
    rig: RigConfig | None,
    sources: tuple[calibration_schema.SourceFileSection, ...],
    board: BoardPattern | None,
    *,
    in_base: bool,
    note: str = "",
) -> calibration_schema.DLTFile:
    """Return the file of a result; `board` is None for control points, `in_base`: the world is the rod-base frame."""
    corners = 0 if board is None else board.corner_count
    cameras = [
        _section(name, result, inputs.identity(rig, name, result.sizes_px[name]), corners) for name in result.dlts
    ]
    return calibration_schema.DLTFile(
        **file_sections.origin(note),
        kind="dlt",
        world="rod base" if in_base else "board",
        world_view=result.world_view,
        board=None if board is None else board.pattern,
        cameras=tuple(cameras),
        test_error=_test(result.cross_validation, by_point=board is None),
        views=result.views,
        sources=sources,
        left_out=file_sections.left_out(result.left_out),
    )


def _test(found: CrossValidation, *, by_point: bool) -> calibration_schema.LeaveOneOut | None:
    mm, px, edges = found.errors_m * MM_PER_M, found.errors_px, found.edges_m * MM_PER_M
    if not (len(mm) or len(px)):
        return None
    return calibration_schema.LeaveOneOut(
        method="leave one point out" if by_point else "leave one view out",
        points=len(mm) or len(px),
        rms_mm=rounded(float(np.sqrt(np.mean(mm**2)))) if len(mm) else None,
        worst_mm=rounded(float(mm.max())) if len(mm) else None,
        rms_px=rounded(float(np.sqrt(np.mean(px**2)))) if len(px) else None,
        edge_mm=rounded(float(edges.mean()), 8) if len(edges) else None,
        edge_std_mm=rounded(float(edges.std())) if len(edges) else None,
    )
