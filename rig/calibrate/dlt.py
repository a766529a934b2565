"""`rig calibrate dlt`: DLT coefficients and poses of cameras, from control points or from boards."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import typer
from numpy.typing import NDArray

from calibration import view_matching
from calibration.camera import CalibrationError, LeftOut, calibrate_views, find_corners
from calibration.cross_validation import CrossValidation, PointObservations, leave_out
from calibration.dlt import DLT, DLTError, calibrate, decompose
from calibration.dlt_bundle_adjustment import adjust
from calibration.extrinsics import Camera, ExtrinsicCalibration, locate
from calibration.views import View, views_in
from calibration.vision.board import Board
from calibration.vision.lens import Lens
from calibration.vision.pose import refine
from calibration.vision.transforms import RigidTransform
from rig.calibrate import control_points, file_sections, inputs
from rig.calibrate.inputs import bad_input
from rig.cli import calibration_output
from rig.cli.console import console
from rig.cli.json_output import plain_json
from rig.config import calibration_schema
from rig.config.calibration_files import LoadedCalibration, default_path, origin, rounded, sha256_of, write
from rig.config.drivers import CAMERA_DRIVERS
from rig.config.optics import lens_of, placement_of, rigid
from rig.config.schema import RigConfig
from rig.config.sections import Placement
from runs.overwriting import refuse_existing

Floats = NDArray[np.float64]

_MOST_LEFT_OUT = 200
_MM = 1e3
_WAYS = ("control points (.csv)", "views of a board")
_WIDEST_MM = 1e6


@dataclass(frozen=True)
class DLTCalibrationRequest:
    """Options of the command."""

    given: tuple[str, ...]
    corners: str
    square_mm: float
    calibrations: tuple[Path, ...]
    rig: str | None
    size: str
    points_std_mm: float
    bundle: bool
    world_view: str
    base: str
    every: int
    to: Path | None
    replace: bool
    note: str
    json: bool


@dataclass(frozen=True)
class DLTCalibrationResult:
    """Coefficients and pose of every camera, with the data of the fit."""

    observations: dict[str, PointObservations]
    dlts: dict[str, DLT]
    places: dict[str, tuple[RigidTransform, Floats]]
    """Camera in the world, and the covariance (6, 6) of that: translation [m], rotation [rad]."""
    trial: CrossValidation
    views: tuple[calibration_schema.UsedView, ...] = ()
    left_out: tuple[LeftOut, ...] = ()
    world_view: str = ""


def run(request: DLTCalibrationRequest) -> None:
    """Calibrate, write the file, print it.

    Raises:
        BadInputError: the command line, the control points or another calibration are invalid.
        ViewsError, CalibrationError, DLTError: the data do not determine the coefficients.
    """
    if request.to is not None:
        refuse_existing([request.to], replace=request.replace)
    if not request.given:
        raise bad_input(
            "CSV|NAME=VIEWS", "", "a CSV of control points, or folders of simultaneous views for each camera"
        )
    is_csv = len(request.given) == 1 and request.given[0].lower().endswith((".csv", ".txt"))
    _refuse_unknown_cameras(request, is_csv)
    rig = inputs.rig_of(request.rig)
    known = inputs.camera_calibrations(list(request.calibrations))
    sizes: dict[str, tuple[int, int]]
    if is_csv:
        csv = Path(request.given[0])
        result, sizes = _from_points(request, csv, rig, known)
        used = [calibration_schema.SourceFile(name=csv.name, sha256=sha256_of(csv))]
    else:
        result, sizes = _from_boards(request, rig, known)
        used = []
    used += [
        calibration_schema.SourceFile(name=Path(one.source.file).name, sha256=one.sha256) for one in known.values()
    ]
    found = _file(request, rig, result, sizes, tuple(used), is_csv)
    made = write(found, request.to or default_path("dlt"), replace=request.replace)
    if request.json:
        typer.echo(json.dumps(plain_json(_facts(result, found, made)), indent=2))
        return
    calibration_output.dlt(found, result.places, console())
    typer.echo(
        calibration_output.written(
            made, any(CAMERA_DRIVERS.simulates(camera.camera.driver) for camera in found.cameras)
        )
    )


def _refuse_unknown_cameras(request: DLTCalibrationRequest, is_csv: bool) -> None:
    """Refuse options that apply only to the other form of input."""
    of_boards = {
        "--corners": request.corners,
        "--square-mm": request.square_mm,
        "--world-view": request.world_view,
        "--base": request.base,
    }
    of_points = {"--size": request.size, "--points-std-mm": request.points_std_mm}
    for option, value in (of_boards if is_csv else of_points).items():
        if value:
            form, other = _WAYS if is_csv else _WAYS[::-1]
            raise bad_input(option, str(value), f"no such option: it is of {other}, and {form} are given")


def _lens(
    name: str, rig: RigConfig | None, known: dict[str, LoadedCalibration], size: tuple[int, int], what: str
) -> Lens | None:
    """A camera's lens by its calibration, or as the rig states it; None where nothing is known."""
    if name in known:
        lens = inputs.checked_size(known[name], size, what).lens
        return Lens.of(lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px, lens.distortion)
    return lens_of(rig.cameras[name]) if rig is not None and name in rig.cameras else None


def _from_points(
    request: DLTCalibrationRequest, csv: Path, rig: RigConfig | None, known: dict[str, LoadedCalibration]
) -> tuple[DLTCalibrationResult, dict[str, tuple[int, int]]]:
    seen = control_points.read(csv)
    if not 0 <= request.points_std_mm < _WIDEST_MM:
        raise bad_input(
            "--points-std-mm", f"{request.points_std_mm:g}", "the points' standard uncertainty in mm, 0 or more"
        )
    observations, sizes = {}, {}
    for name, points in seen.items():
        sizes[name] = _size_of(request, name, rig, known)
        lens = _lens(name, rig, known, sizes[name], "the pictures are")
        observations[name] = PointObservations(points.names, points.world_m, points.pixels, lens)
    dlts = {name: _fitted(name, observation) for name, observation in observations.items()}
    if request.bundle and request.points_std_mm > 0:
        better = adjust(list(observations.values()), list(dlts.values()), request.points_std_mm * 1e-3)
        dlts = dict(zip(dlts, better, strict=True))
    places = {name: _place(observation, dlts[name]) for name, observation in observations.items()}
    names = sorted({name for observation in observations.values() for name in observation.names})
    groups = {name: (name,) for name in names[:_MOST_LEFT_OUT]}
    return DLTCalibrationResult(observations, dlts, places, leave_out(list(observations.values()), groups)), sizes


def _fitted(name: str, observation: PointObservations) -> DLT:
    try:
        return calibrate(observation.world_m, observation.pixels, observation.lens)
    except DLTError as error:
        raise DLTError(f"camera {name}: {error}") from None


def _size_of(
    request: DLTCalibrationRequest, name: str, rig: RigConfig | None, known: dict[str, LoadedCalibration]
) -> tuple[int, int]:
    """Return the size of a camera's pictures: from --size, its calibration or the rig."""
    if request.size:
        width, cross, height = request.size.partition("x")
        if not (cross and width.isdecimal() and height.isdecimal() and 64 <= min(int(width), int(height)) <= 16384):
            raise bad_input("--size", request.size, "width and height of the pictures in px, as 640x480")
        return int(width), int(height)
    if name in known:
        camera = known[name].found.camera  # type: ignore[union-attr]
        return camera.width_px, camera.height_px
    if rig is not None and name in rig.cameras:
        return rig.cameras[name].width_px, rig.cameras[name].height_px
    raise bad_input("--size", "", f"the size of camera {name}'s pictures, as 640x480; or --calibration, or --rig")


def _place(observation: PointObservations, dlt: DLT) -> tuple[RigidTransform, Floats]:
    """Where a camera stands: by its lens and the control points, or without a lens by the coefficients alone."""
    _, camera = decompose(dlt)
    if observation.lens is None:
        return camera, np.full((6, 6), np.nan)
    inverse = camera.inverse()
    start = np.asarray(cv2.Rodrigues(inverse.rotation)[0], np.float64).ravel(), inverse.translation_m
    spread = np.sum(dlt.residuals_px**2) / max(dlt.residuals_px.size - 11, 1)
    noise = np.broadcast_to(max(float(spread), 1e-6) * np.eye(2), (len(observation.pixels), 2, 2))
    pose = refine(observation.world_m, observation.pixels, observation.lens, start, noise)
    if pose is None:
        return camera, np.full((6, 6), np.nan)
    return _inverted(pose.rigid, pose.covariance)


def _inverted(world_in_camera: RigidTransform, covariance: Floats) -> tuple[RigidTransform, Floats]:
    """The camera in the world with covariance (6, 6), from the world before the camera (rotation vector first)."""
    camera = world_in_camera.inverse()
    start = np.concatenate([cv2.Rodrigues(world_in_camera.rotation)[0].ravel(), world_in_camera.translation_m])
    slope = np.empty((6, 6))
    for k in range(6):
        step = 1e-6 * (np.arange(6) == k)
        moved = RigidTransform.from_vectors((start + step)[:3], (start + step)[3:]).inverse()
        off = moved.rotation @ camera.rotation.T
        turn = np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]]) / 2
        slope[:, k] = np.concatenate([moved.translation_m - camera.translation_m, turn]) / 1e-6
    return camera, np.asarray(slope @ covariance @ slope.T)


def _from_boards(
    request: DLTCalibrationRequest, rig: RigConfig | None, known: dict[str, LoadedCalibration]
) -> tuple[DLTCalibrationResult, dict[str, tuple[int, int]]]:
    corners, square_m = inputs.corners_of(request.corners), inputs.square_of(request.square_mm)
    board, base = Board(corners[0] + 1, corners[1] + 1, square_m), _base(request)
    listed = inputs.sources_of(list(request.given), rig)
    cameras, sizes, hashes, left_out = _seen(request, listed, board, rig, known)
    extrinsics = locate(cameras, board, bundle=request.bundle)
    left_out += [LeftOut(key, why, _hash(hashes, key)) for key, why in extrinsics.left_out]
    world_view = _world_view(request, extrinsics, hashes)
    places, boards = extrinsics.in_world(world_view, base)
    observations = {}
    groups = {key: tuple(f"{key}:{k}" for k in range(len(board.corners_m))) for key in extrinsics.boards}
    for camera in cameras:
        seen = extrinsics.corners_px[camera.name]
        observations[camera.name] = PointObservations(
            tuple(name for key in seen for name in groups[key]),
            np.concatenate([boards[key].apply(board.corners_m) for key in seen]),
            np.concatenate(list(seen.values())),
            camera.lens,
        )
    dlts = {name: _fitted(name, observation) for name, observation in observations.items()}
    located = {
        name: (
            place,
            extrinsics.placement_covariance(name, world_view, base) if request.bundle else np.full((6, 6), np.nan),
        )
        for name, place in places.items()
    }
    views = tuple(
        calibration_schema.UsedView(
            name=f"{name}:{file}",
            sha256=sha,
            corners=len(board.corners_m),
            rms_px=rounded(float(np.sqrt(np.mean(np.sum(extrinsics.residuals_px[name][key] ** 2, axis=1))))),
        )
        for name, found in hashes.items()
        for key, (file, sha) in found.items()
        if key in extrinsics.residuals_px[name]
    )
    return (
        DLTCalibrationResult(
            observations,
            dlts,
            located,
            leave_out(list(observations.values()), groups, board),
            views,
            tuple(left_out),
            world_view,
        ),
        sizes,
    )


Hashes = dict[str, dict[str, tuple[str, str]]]


def _seen(
    request: DLTCalibrationRequest,
    listed: tuple[inputs.CameraViews, ...],
    board: Board,
    rig: RigConfig | None,
    known: dict[str, LoadedCalibration],
) -> tuple[list[Camera], dict[str, tuple[int, int]], Hashes, list[LeftOut]]:
    """What each camera saw, by moments; a lens that is not known is found from the same views."""
    found: dict[str, dict[str, tuple[str, Floats]]] = {}
    lenses, sizes, left_out = {}, {}, []
    for source in listed:
        name = source.camera
        views = list(views_in(source.views, request.every))
        sizes[name] = views[0].image.shape[1], views[0].image.shape[0]
        inputs.identity_sized(rig, name, sizes[name])
        lens = _lens(name, rig, known, sizes[name], f"the views in {source.views}")
        if lens is None:
            made = calibrate_views(views, board.pattern, board.square_m)
            lens = made.lens
            sharp = [(v.name, v.sha256, v.corners_px) for v in made.views]
            left_out += [replace_name(out, name) for out in made.skipped]
        else:
            sharp = []
            for view in views:
                corners = _corners_in(view, sizes[name], board)
                if corners is None:
                    why = f"no board of {board.pattern[0]}x{board.pattern[1]} inner corners found"
                    left_out.append(LeftOut(f"{name}:{view.name}", why, view.sha256))
                else:
                    sharp.append((view.name, view.sha256, corners))
        lenses[name] = lens
        found[name] = {file: (sha, px) for file, sha, px in sharp}
    keys = view_matching.keys({name: list(files) for name, files in found.items()})
    hashes = {name: {keys[name][f]: (f, sha) for f, (sha, _) in files.items()} for name, files in found.items()}
    cameras = [
        Camera(name, lenses[name], {keys[name][f]: px for f, (_, px) in files.items()}) for name, files in found.items()
    ]
    return cameras, sizes, hashes, left_out


def replace_name(out: LeftOut, camera: str) -> LeftOut:
    """A view that was left out, with its camera's name before its own."""
    return out._replace(name=f"{camera}:{out.name}")


def _corners_in(view: View, size: tuple[int, int], board: Board) -> Floats | None:
    if (view.image.shape[1], view.image.shape[0]) != size:
        raise CalibrationError(
            f"{view.name} is {view.image.shape[1]}x{view.image.shape[0]} and the views before it {size[0]}x{size[1]}"
        )
    return find_corners(view.image, board.pattern)


def _hash(hashes: Hashes, key: str) -> str:
    return next(found[key][1] for found in hashes.values() if key in found)


def _world_view(request: DLTCalibrationRequest, extrinsics: ExtrinsicCalibration, hashes: Hashes) -> str:
    """Return the view that defines the world: from --world-view, by default the one that most cameras see."""
    if not request.world_view:
        return max(extrinsics.boards, key=lambda key: sum(key in views for views in extrinsics.corners_px.values()))
    for found in hashes.values():
        for key, (file, _) in found.items():
            if request.world_view in (file, Path(file).stem, key) and key in extrinsics.boards:
                return key
    raise bad_input("--world-view", request.world_view, f"a view that shows the board: {', '.join(extrinsics.boards)}")


def _base(request: DLTCalibrationRequest) -> RigidTransform:
    """Return the pose of the world view's board in the rod-base frame; the identity by default."""
    if not request.base:
        return RigidTransform(np.eye(3), np.zeros(3))
    parts = request.base.replace(" ", "").split(",")
    try:
        x, y, z, a, b, c = (float(part) for part in parts)
    except ValueError:
        x = y = z = a = b = c = np.inf
    if not all(abs(number) < _WIDEST_MM for number in (x, y, z, a, b, c)):
        raise bad_input("--base", request.base, "six numbers X,Y,Z,A,B,C: mm, and a rotation vector in deg")
    return rigid(Placement(translation_mm=(x, y, z), rotation_deg=(a, b, c)))


def _points(names: tuple[str, ...], *, boards: bool) -> tuple[str, ...]:
    """Names of control points, or of the views whose corners they are."""
    return tuple(dict.fromkeys(name.rpartition(":")[0] for name in names)) if boards else names


def _section(
    name: str, result: DLTCalibrationResult, identity: calibration_schema.CameraIdentity
) -> calibration_schema.DLTCamera:
    dlt, observation = result.dlts[name], result.observations[name]
    place, covariance = result.places[name]
    # World in mm: what multiplies a coordinate is a thousand times smaller.
    scale = np.where(np.isin(np.arange(11), (3, 7)), 1.0, 1 / _MM)
    units = np.array([_MM] * 3 + [np.rad2deg(1)] * 3)
    spread = covariance * np.outer(units, units)
    known = bool(np.all(np.isfinite(spread)))
    std = np.sqrt(np.diag(spread)) if known else np.zeros(6)
    placement = placement_of(
        replace(place, translation_std_m=float(np.sqrt(np.mean(std[:3] ** 2))) / _MM,
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
        points=_points(observation.names, boards=bool(result.world_view)),
        residuals_px=rounded(dlt.residuals_px.ravel(), 3),
    )


def _file(
    request: DLTCalibrationRequest,
    rig: RigConfig | None,
    result: DLTCalibrationResult,
    sizes: dict[str, tuple[int, int]],
    used: tuple[calibration_schema.SourceFile, ...],
    is_csv: bool,
) -> calibration_schema.DLTFile:
    cameras = [_section(n, result, inputs.identity_sized(rig, n, sizes[n])) for n in result.dlts]
    return calibration_schema.DLTFile(
        **origin(request.note),
        kind="dlt",
        world="rod base" if is_csv or request.base else "board",
        world_view=result.world_view,
        board=None
        if is_csv
        else file_sections.board_section(inputs.corners_of(request.corners), request.square_mm * 1e-3),
        cameras=tuple(cameras),
        test_error=_test(result.trial, is_csv),
        views=result.views,
        sources=used,
        left_out=file_sections.left_out(result.left_out),
    )


def _test(trial: CrossValidation, is_csv: bool) -> calibration_schema.LeaveOneOut | None:
    mm, px, edges = trial.errors_m * _MM, trial.errors_px, trial.edges_m * _MM
    if not (len(mm) or len(px)):
        return None
    return calibration_schema.LeaveOneOut(
        method="leave one point out" if is_csv else "leave one view out",
        points=len(mm) or len(px),
        rms_mm=rounded(float(np.sqrt(np.mean(mm**2)))) if len(mm) else None,
        worst_mm=rounded(float(mm.max())) if len(mm) else None,
        rms_px=rounded(float(np.sqrt(np.mean(px**2)))) if len(px) else None,
        square_mm=rounded(float(edges.mean()), 8) if len(edges) else None,
        square_std_mm=rounded(float(edges.std())) if len(edges) else None,
    )


def _facts(result: DLTCalibrationResult, found: calibration_schema.DLTFile, made: Path) -> dict[str, object]:
    return {
        "file": str(made),
        "world": found.world,
        "world_view": found.world_view,
        "cameras": {
            camera.camera.name: {
                "coefficients_px_mm": camera.coefficients_px_mm,
                "rms_px": camera.rms_px,
                "lens": None if camera.lens is None else camera.lens.model_dump(),
                "placement": camera.placement.model_dump(),
            }
            for camera in found.cameras
        },
        "pairs": calibration_output.pairs(result.places),
        "test_error": None if found.test_error is None else found.test_error.model_dump(exclude_none=True),
        "skipped": {out.name: out.reason for out in found.left_out},
    }
