"""Calibration of cameras: intrinsics from views of a board, with a figure of the residuals."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from calibration.camera import CameraCalibration, calibrate, calibrate_views
from calibration.views import View
from calibration.vision.board import Board
from protocols.problems import bad_input
from rig.calibrate import file_sections, inputs, residual_figure
from rig.calibrate.bench_operator import BenchOperator
from rig.calibrate.file_sections import OutputFile
from rig.calibrate.view_collection import collect, pictures
from rig.config.board_sections import BoardPattern
from rig.config.calibration_files import views_beside
from rig.config.loader import load
from rig.config.schema import RigConfig
from runs.overwriting import refuse_existing

_PICTURE = ".png"


@dataclass(frozen=True)
class CameraCalibrationRequest:
    """Options of the procedure."""

    views: tuple[str, ...] = ()
    corners: str = ""
    square_mm: float = 0.0
    capture: bool = False
    rig: str | None = None
    camera: str | None = None
    count: int = 20
    every: int = 1
    seed: int = 0
    output: OutputFile = field(default_factory=OutputFile)


@dataclass(frozen=True)
class CalibratedCamera:
    """The result for one camera, its file and its figure."""

    name: str
    found: CameraCalibration
    file: Path
    figure: Path
    simulated: bool


def run(request: CameraCalibrationRequest, operator: BenchOperator) -> tuple[CalibratedCamera, ...]:
    """Calibrate every named camera; write a file and a figure for each.

    Raises:
        BadInputError: the options are invalid.
        ViewsError, CalibrationError: the views do not determine a camera.
        CameraError: a live camera delivers no pictures.
    """
    _refuse_of_other_source(request)
    rig = None if request.rig is None else load(request.rig)
    board = inputs.shown_board(request.corners, request.square_mm, rig)
    _check_output(request)
    listed: list[tuple[str, Path, CameraCalibration]] = []
    if request.capture:
        if request.views:
            raise bad_input("--capture", request.views[0], "either existing views or captured ones")
        if rig is None:
            raise bad_input("--capture", "", "--rig as well: whose camera is it?")
        name = inputs.known_camera(rig, request.camera)
        file = request.output.path(f"camera-{name}")
        views = _captured(request, operator, rig, name, board.board(), file)
        listed.append((name, file, calibrate_views(views, board.board())))
    else:
        if not request.views:
            raise bad_input("VIEWS", "", "a folder, a video or a pattern of the board's pictures; or --capture")
        if request.camera is not None and rig is not None:
            inputs.known_camera(rig, request.camera)
        for name, source in inputs.sources_of(request.views, rig, request.camera).items():
            found = calibrate(source, board.board(), request.every)
            listed.append((name, request.output.path(f"camera-{name}"), found))
    return tuple(_written(request, rig, name, board, file, found) for name, file, found in listed)


def _refuse_of_other_source(request: CameraCalibrationRequest) -> None:
    """Refuse options that apply only to captured views, or only to existing ones."""
    default = CameraCalibrationRequest()
    of_captured = {"--count": (request.count, default.count), "--seed": (request.seed, default.seed)}
    of_existing = {"--every": (request.every, default.every)}
    given, other = ("captured", "existing") if request.capture else ("existing", "captured")
    for option, (value, unset) in (of_existing if request.capture else of_captured).items():
        if value != unset:
            raise bad_input(option, str(value), f"no such option: it is of {other} views, and these are {given}")


def _check_output(request: CameraCalibrationRequest) -> None:
    """Refuse a name for the output that cannot be used, before anything is measured."""
    to = request.output.to
    if to is None:
        return
    if len(request.views) > 1:
        raise bad_input("--to", str(to), "one camera at a time; each of several gets a dated name of its own")
    if to.suffix.lower() == _PICTURE:
        raise bad_input("--to", str(to), "a name for the YAML file; the picture goes beside it with this ending")
    request.output.check()
    refuse_existing([to.with_suffix(_PICTURE)], replace=request.output.replace)


def _captured(
    request: CameraCalibrationRequest,
    operator: BenchOperator,
    rig: RigConfig,
    name: str,
    board: Board,
    file: Path,
) -> list[View]:
    """Capture views with the rig's camera; keep them as pictures beside the file."""
    folder = views_beside(file, request.output.replace)
    operator.tell(f"views go to {folder}; Enter: enough, Ctrl-C: give up")
    with operator.keys() as keys:
        return collect(
            pictures(rig, name, board, request.seed),
            board,
            request.count,
            folder,
            operator.tell,
            lambda: "\n" in keys.pressed(),
        )


def _written(
    request: CameraCalibrationRequest,
    rig: RigConfig | None,
    name: str,
    board: BoardPattern,
    file: Path,
    found: CameraCalibration,
) -> CalibratedCamera:
    content = file_sections.camera_file(
        found, inputs.identity(rig, name, (found.width_px, found.height_px)), board, request.output.note
    )
    made = request.output.write(content, file)
    figure = residual_figure.write(found, f"camera {name}", made.with_suffix(_PICTURE))
    simulated = rig is not None and name in rig.cameras and rig.cameras[name].simulated
    return CalibratedCamera(name, found, made, figure, simulated)
