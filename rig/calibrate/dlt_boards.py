"""DLT calibration from simultaneous views of a board."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from calibration import view_matching
from calibration.camera import CalibrationError, ExcludedView, calibrate_views
from calibration.corner_search import SeenCorners, no_board, seen_corners
from calibration.cross_validation import PointObservations, leave_out
from calibration.extrinsics import CameraSightings, ExtrinsicCalibration, locate
from calibration.views import View, views_in
from calibration.vision.board import Board
from calibration.vision.transforms import RigidTransform
from protocols.problems import bad_input
from rig.calibrate import inputs
from rig.calibrate.dlt_fit import DLTCalibrationResult, fitted, known_lens
from rig.config import calibration_schema
from rig.config.calibration_files import LoadedCalibration, rounded
from rig.config.schema import RigConfig


@dataclass(frozen=True)
class SeenBoards:
    """What the cameras saw: lenses and corners, sizes of the pictures, and files by camera and moment."""

    cameras: list[CameraSightings]
    sizes_px: dict[str, tuple[int, int]]
    files: dict[str, dict[str, tuple[str, str]]]
    """Name and SHA-256 of each picture."""
    left_out: list[ExcludedView]

    def sha256_at(self, moment: str) -> str:
        """Return the SHA-256 of the first picture of a moment."""
        return next(files[moment][1] for files in self.files.values() if moment in files)


def from_boards(
    sources: Mapping[str, Path],
    board: Board,
    rig: RigConfig | None,
    known: dict[str, LoadedCalibration],
    *,
    world_view: str,
    base: RigidTransform | None,
    every: int,
) -> DLTCalibrationResult:
    """Calibrate cameras from simultaneous views of a board.

    `world_view`: the view whose board defines the world, empty for the one that most cameras see; `base`: the pose of
    that board in the rod-base frame, if it is known. `known`: other calibrations, by camera. `every`: use every Nth
    frame of a video.

    Raises:
        BadInputError: no view has the name `world_view`, or a picture has another size than the rig's camera.
        ViewsError, CalibrationError, DLTError: the views do not determine the cameras.
    """
    base = RigidTransform(np.eye(3), np.zeros(3)) if base is None else base
    views = _seen(sources, every, board, rig, known)
    extrinsics = locate(views.cameras, board)
    world = _world_view(world_view, extrinsics, views)
    places, boards = extrinsics.in_world(world, base)
    observations = {}
    groups = {key: tuple(f"{key}:{k}" for k in range(len(board.corners_m))) for key in extrinsics.boards}
    for camera in views.cameras:
        seen = extrinsics.corners[camera.name]
        observations[camera.name] = PointObservations(
            tuple(groups[key][k] for key, corners in seen.items() for k in corners.which),
            np.concatenate([boards[key].apply(board.corners_m[corners.which]) for key, corners in seen.items()]),
            np.concatenate([corners.px for corners in seen.values()]),
            camera.lens,
        )
    return DLTCalibrationResult(
        observations,
        {name: fitted(name, observation) for name, observation in observations.items()},
        {name: (place, extrinsics.placement_covariance(name, world, base)) for name, place in places.items()},
        leave_out(list(observations.values()), groups, board),
        views.sizes_px,
        _used_views(views, extrinsics),
        (*views.left_out, *(ExcludedView(key, why, views.sha256_at(key)) for key, why in extrinsics.left_out)),
        world,
        {pair: extrinsics.baseline_m(*pair) for pair in combinations(extrinsics.cameras, 2)},
    )


def _used_views(views: SeenBoards, extrinsics: ExtrinsicCalibration) -> tuple[calibration_schema.UsedView, ...]:
    return tuple(
        calibration_schema.UsedView(
            name=f"{name}:{file}",
            sha256=sha,
            corners=len(extrinsics.residuals_px[name][key]),
            rms_px=rounded(float(np.sqrt(np.mean(np.sum(extrinsics.residuals_px[name][key] ** 2, axis=1))))),
        )
        for name, files in views.files.items()
        for key, (file, sha) in files.items()
        if key in extrinsics.residuals_px[name]
    )


def _seen(
    sources: Mapping[str, Path],
    every: int,
    board: Board,
    rig: RigConfig | None,
    known: dict[str, LoadedCalibration],
) -> SeenBoards:
    """Find the boards in all views; a lens that is not known is calibrated from the same views."""
    found: dict[str, dict[str, tuple[str, SeenCorners]]] = {}
    lenses, sizes, left_out = {}, {}, []
    for name, source in sources.items():
        views = list(views_in(source, every))
        size = sizes[name] = views[0].image.shape[1], views[0].image.shape[0]
        inputs.identity(rig, name, size)
        lens = known_lens(name, rig, known, size, f"the views in {source}")
        if lens is None:
            made = calibrate_views(views, board)
            lens = made.lens
            sharp = [(v.name, v.sha256, v.corners) for v in made.views]
            skipped = list(made.skipped)
        else:
            sharp, skipped = _corners_in(views, size, board)
        left_out += [out._replace(name=f"{name}:{out.name}") for out in skipped]
        lenses[name] = lens
        found[name] = {file: (sha, corners) for file, sha, corners in sharp}
    keys = view_matching.keys({name: list(files) for name, files in found.items()})
    return SeenBoards(
        [
            CameraSightings(name, lenses[name], {keys[name][f]: corners for f, (_, corners) in files.items()})
            for name, files in found.items()
        ],
        sizes,
        {name: {keys[name][f]: (f, sha) for f, (sha, _) in files.items()} for name, files in found.items()},
        left_out,
    )


def _corners_in(
    views: Sequence[View], size: tuple[int, int], board: Board
) -> tuple[list[tuple[str, str, SeenCorners]], list[ExcludedView]]:
    """Return name, SHA-256 and corners of the views that show the board, and the other views."""
    sharp, skipped = [], []
    for view in views:
        if (view.image.shape[1], view.image.shape[0]) != size:
            raise CalibrationError(
                f"{view.name} is {view.image.shape[1]}x{view.image.shape[0]} and the views before it "
                f"{size[0]}x{size[1]}"
            )
        corners = seen_corners(board, view.image)
        if corners is None:
            skipped.append(ExcludedView(view.name, no_board(view.image, board), view.sha256))
        else:
            sharp.append((view.name, view.sha256, corners))
    return sharp, skipped


def _world_view(wanted: str, extrinsics: ExtrinsicCalibration, views: SeenBoards) -> str:
    """Return the key of the view that defines the world: the wanted one, or the one that most cameras see."""
    if not wanted:
        return max(extrinsics.boards, key=lambda key: sum(key in seen for seen in extrinsics.corners.values()))
    for files in views.files.values():
        for key, (file, _) in files.items():
            if wanted in (file, Path(file).stem, key) and key in extrinsics.boards:
                return key
    raise bad_input("--world-view", wanted, f"a view that shows the board: {', '.join(extrinsics.boards)}")
