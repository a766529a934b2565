"""Calibration of cameras: intrinsics from views of a board, with a figure of the residuals."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from calibration.camera import CameraCalibration, calibrate, calibrate_views
from calibration.views import View
from calibration.vision.board import Board
from protocols.problems import bad_input
from rig.calibrate import file_sections, inputs
from rig.calibrate.bench_operator import BenchOperator
from rig.calibrate.file_sections import OutputFile
from rig.calibrate.view_collection import collect, pictures
from rig.config.board_sections import BoardPattern
from rig.config.calibration_files import views_beside
from rig.config.drivers import Reality
from rig.config.loader import load
from rig.config.schema import RigConfig
from runs.overwriting import refuse_existing, replacing

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
    figure = _draw_residuals(found, f"camera {name}", made.with_suffix(_PICTURE))
    simulated = rig is not None and name in rig.cameras and rig.cameras[name].reality is not Reality.REAL
    return CalibratedCamera(name, found, made, figure, simulated)


_USED, _OUT = "#2f6f9f", "#b8443c"
_LONGEST_SHARE = 0.06
_MOST_NAMES = 40


def _draw_residuals(found: CameraCalibration, title: str, path: Path) -> Path:
    """Write a PNG: residual vectors (drawn larger, the scale is stated), RMS of each view, corners per cell."""
    figure = Figure(figsize=(14, 9), layout="constrained")
    figure.suptitle(f"{title}: {len(found.views)} views, rms {found.rms_px:.3f} px")
    grid = figure.add_gridspec(2, 2, width_ratios=(3, 2))
    _residuals(figure.add_subplot(grid[0, 0]), found)
    _heat(figure.add_subplot(grid[1, 0]), found)
    _views(figure.add_subplot(grid[:, 1]), found)
    with replacing(path) as part:
        figure.savefig(part, dpi=100, format="png")
    return path


def _frame(axes, found: CameraCalibration, title: str) -> None:  # type: ignore[no-untyped-def]
    axes.set_xlim(0, found.width_px)
    axes.set_ylim(found.height_px, 0)
    axes.set_aspect("equal")
    axes.set_title(title)
    axes.set_xlabel("u [px]")
    axes.set_ylabel("v [px]")


def _residuals(axes, found: CameraCalibration) -> None:  # type: ignore[no-untyped-def]
    corners = np.concatenate([v.corners.px for v in found.views])
    residuals = np.concatenate([v.residuals_px for v in found.views])
    length = np.linalg.norm(residuals, axis=1)
    usual = max(float(np.percentile(length, 95)), 1e-6)
    # One, two or five times a power of ten: a scale that can be read off.
    largest = _LONGEST_SHARE * found.width_px / usual
    power = 10 ** np.floor(np.log10(largest))
    scale = max(k * power for k in (1, 2, 5) if k * power <= largest)
    axes.quiver(
        *corners.T, *(residuals * scale).T, length, angles="xy", scale_units="xy", scale=1, width=0.0015, cmap="viridis"
    )
    axes.plot(found.parameters[2], found.parameters[3], "+", color=_OUT, markersize=12)
    _frame(axes, found, f"residuals, measured - projected, drawn {scale:g} times; + principal point")


def _heat(axes, found: CameraCalibration) -> None:  # type: ignore[no-untyped-def]
    counts = found.coverage.heat()
    extent = (0, found.width_px, found.height_px, 0)
    image = axes.imshow(np.where(counts > 0, counts, np.nan), extent=extent, cmap="YlGn", vmin=0)
    axes.figure.colorbar(image, ax=axes, label="corners per cell (white: none)")
    _frame(axes, found, f"coverage: {found.coverage.share:.0%} of the picture")


def _views(axes, found: CameraCalibration) -> None:  # type: ignore[no-untyped-def]
    names = [v.name for v in found.views] + [f"{s.name} (left out)" for s in found.skipped]
    rms = [v.rms_px for v in found.views] + [0.0] * len(found.skipped)
    places = np.arange(len(names))
    axes.barh(places, rms, color=[_USED] * len(found.views) + [_OUT] * len(found.skipped))
    axes.axvline(found.rms_px, color="k", linewidth=0.8, linestyle="--")
    step = -(-len(names) // _MOST_NAMES)
    axes.set_yticks(places[::step], names[::step], fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel("rms [px]")
    axes.set_title("each view")
