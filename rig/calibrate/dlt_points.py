"""DLT calibration from a CSV of control points; one row for each point that a camera saw."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from calibration.cross_validation import PointObservations, leave_out
from calibration.dlt_bundle_adjustment import adjust
from calibration.vision.transforms import RigidTransform
from model.arrays import Array
from protocols import Problem
from protocols.problems import bad_input, raise_all
from rig.calibrate import inputs
from rig.calibrate.dlt_fit import DLTCalibrationResult, camera_in_world, fitted, known_lens
from rig.config.calibration_files import LoadedCalibration
from rig.config.schema import RigConfig

COLUMNS = ("point", "X_mm", "Y_mm", "Z_mm", "camera", "u_px", "v_px")
_MOST_PROBLEMS = 40
_MOST_LEFT_OUT = 200
WIDEST_MM = 1e6


def from_points(
    csv: Path, size: str, points_std_mm: float, rig: RigConfig | None, known: dict[str, LoadedCalibration]
) -> DLTCalibrationResult:
    """Calibrate cameras from control points.

    `size`: width and height of the pictures, as 640x480; `known`: other calibrations, by camera. With an
    uncertainty of the points, bundle adjustment refines the coefficients.

    Raises:
        BadInputError: a cell or an option is invalid. DLTError: the points do not determine the coefficients.
    """
    seen = _control_points(csv)
    if not 0 <= points_std_mm < WIDEST_MM:
        raise bad_input("--points-std-mm", f"{points_std_mm:g}", "the points' standard uncertainty in mm, 0 or more")
    observations, sizes = {}, {}
    for name, points in seen.items():
        sizes[name] = _size_of(size, name, rig, known)
        lens = known_lens(name, rig, known, sizes[name], "the pictures are")
        observations[name] = replace(points, lens=lens)
    dlts = {name: fitted(name, observation) for name, observation in observations.items()}
    if points_std_mm > 0:
        better = adjust(list(observations.values()), list(dlts.values()), points_std_mm * 1e-3)
        dlts = dict(zip(dlts, better, strict=True))
    places = {name: camera_in_world(observation, dlts[name]) for name, observation in observations.items()}
    names = sorted({name for observation in observations.values() for name in observation.names})
    groups = {name: (name,) for name in names[:_MOST_LEFT_OUT]}
    return DLTCalibrationResult(
        observations,
        dlts,
        places,
        leave_out(list(observations.values()), groups),
        sizes,
        baselines_m={(a, b): _baseline_m(places[a], places[b]) for a, b in combinations(places, 2)},
    )


def _control_points(path: Path) -> dict[str, PointObservations]:
    """Control points by camera, without its lens; `BadInput` with every cell that cannot be."""
    rows = inputs.table(path, COLUMNS)
    problems: list[Problem] = []
    known: dict[str, tuple[float, ...]] = {}
    found: dict[str, dict[str, tuple[tuple[float, ...], tuple[float, ...]]]] = {}
    for line, row in rows:
        place = tuple(inputs.number(path, line, name, row[name], problems) for name in COLUMNS[1:4])
        pixel = tuple(inputs.number(path, line, name, row[name], problems) for name in COLUMNS[5:])
        point, camera = row["point"], row["camera"]
        problems += [
            Problem(str(path), line, 0, name, "", "is missing: a name or a number")
            for name in ("point", "camera")
            if not row[name]
        ]
        if known.setdefault(point, place) != place:
            conflict = ", ".join(f"{x:g}" for x in known[point])
            problems.append(
                Problem(str(path), line, 0, "X_mm, Y_mm, Z_mm", ", ".join(f"{x:g}" for x in place),
                        f"{conflict}, as in an earlier row of point {point}")
            )  # fmt: skip
        if point in found.setdefault(camera, {}):
            problems.append(Problem(str(path), line, 0, "point", point, f"each point once for camera {camera}"))
        found[camera][point] = place, pixel
    raise_all(problems[:_MOST_PROBLEMS])
    return {
        camera: PointObservations(
            tuple(points),
            np.array([place for place, _ in points.values()]) * 1e-3,
            np.array([pixel for _, pixel in points.values()]),
        )
        for camera, points in found.items()
    }


def _baseline_m(one: tuple[RigidTransform, Array], other: tuple[RigidTransform, Array]) -> tuple[float, float]:
    """Distance of two cameras that were placed independently, and its standard uncertainty."""
    apart = other[0].translation_m - one[0].translation_m
    distance = float(np.linalg.norm(apart))
    along = apart / distance
    return distance, float(np.sqrt(along @ (one[1] + other[1])[:3, :3] @ along))


def _size_of(size: str, name: str, rig: RigConfig | None, known: dict[str, LoadedCalibration]) -> tuple[int, int]:
    """Return the size of a camera's pictures: from --size, its calibration or the rig."""
    if size:
        width, cross, height = size.partition("x")
        if not (cross and width.isdecimal() and height.isdecimal() and 64 <= min(int(width), int(height)) <= 16384):
            raise bad_input("--size", size, "width and height of the pictures in px, as 640x480")
        return int(width), int(height)
    if name in known:
        camera = known[name].found.camera  # type: ignore[union-attr]
        return camera.width_px, camera.height_px
    if rig is not None and name in rig.cameras:
        return rig.cameras[name].width_px, rig.cameras[name].height_px
    raise bad_input("--size", "", f"the size of camera {name}'s pictures, as 640x480; or --calibration, or --rig")
