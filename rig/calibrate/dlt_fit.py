"""DLT coefficients and pose of one camera, and the result for all of them."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from calibration.camera import ExcludedView
from calibration.cross_validation import CrossValidation, PointObservations
from calibration.dlt import DLT, DLTError, calibrate, decompose
from calibration.vision.lens import Lens
from calibration.vision.pose import refine
from calibration.vision.transforms import RigidTransform
from model.arrays import Array
from rig.calibrate import inputs
from rig.config import calibration_schema
from rig.config.calibration_files import LoadedCalibration
from rig.config.optics import lens_of
from rig.config.schema import RigConfig


@dataclass(frozen=True)
class DLTCalibrationResult:
    """Coefficients and pose of every camera, with the data of the fit; `sizes_px` is (width, height) by camera."""

    observations: dict[str, PointObservations]
    dlts: dict[str, DLT]
    places: dict[str, tuple[RigidTransform, Array]]
    """Camera in the world, and the covariance (6, 6) of that: translation [m], rotation [rad]."""
    cross_validation: CrossValidation
    sizes_px: dict[str, tuple[int, int]]
    views: tuple[calibration_schema.UsedView, ...] = ()
    left_out: tuple[ExcludedView, ...] = ()
    world_view: str = ""
    baselines_m: dict[tuple[str, str], tuple[float, float]] = field(default_factory=dict)
    """Distance of each two cameras and its standard uncertainty, NaN if that is not known."""


def fitted(name: str, observation: PointObservations) -> DLT:
    """Return the coefficients of one camera.

    Raises:
        DLTError: the points do not determine them.
    """
    try:
        return calibrate(observation.world_m, observation.pixels, observation.lens)
    except DLTError as error:
        raise DLTError(f"camera {name}: {error}") from None


def known_lens(
    name: str, rig: RigConfig | None, known: dict[str, LoadedCalibration], size: tuple[int, int], what: str
) -> Lens | None:
    """A camera's lens by its calibration, or as the rig states it; None where nothing is known."""
    if name in known:
        lens = inputs.checked_size(known[name], size, what).lens
        return Lens.of(lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px, lens.distortion)
    return lens_of(rig.cameras[name]) if rig is not None and name in rig.cameras else None


def camera_in_world(observation: PointObservations, dlt: DLT) -> tuple[RigidTransform, Array]:
    """The pose of a camera: from its lens and the control points, or without a lens from the coefficients alone."""
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
    return inverted(pose.rigid, pose.covariance)


def inverted(world_in_camera: RigidTransform, covariance: Array) -> tuple[RigidTransform, Array]:
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
