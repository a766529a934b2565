"""The file of a DLT calibration, in the units of files."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibration.cross_validation import CrossValidation
from model.units import MM_PER_M
from rig.calibrate import file_sections, inputs
from rig.calibrate.dlt_fit import DLTCalibrationResult
from rig.config import calibration_schema
from rig.config.board_sections import BoardPattern
from rig.config.calibration_files import rounded
from rig.config.optics import placement_of
from rig.config.schema import RigConfig


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
