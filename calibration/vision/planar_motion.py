"""Motion in a known plane as a prior on the pose of the board."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from calibration.vision import projection
from calibration.vision.projection import slope_by_turn, turned
from calibration.vision.transforms import RigidTransform
from model.arrays import Array
from model.kernels.jit import kernel

DEPARTURES = 3
"""Residuals of a pose from a plane: the offset and two tilts."""

exact_kernel = partial(kernel, sources=(__file__, projection.__file__), fastmath=False)


class PlaneArguments(NamedTuple):
    """A plane of motion as the kernels take it, in the camera frame.

    The tip and the normal fixed to it (3,) are those in the board frame. The plane is `normal` x = `distance_m`;
    `across` (2, 3) are two directions in it. `offset_variance_m2` grows by the square of `lever_rad` times the distance
    of the tip from the camera.
    """

    tip: Array
    tip_normal: Array
    normal: Array
    across: Array
    distance_m: float
    offset_variance_m2: float
    lever_rad: float
    tilt_std_rad: float


NO_PLANE = PlaneArguments(np.zeros(3), np.zeros(3), np.zeros(3), np.zeros((2, 3)), 0.0, 0.0, 0.0, 0.0)
"""For the kernels where there is no prior."""


@exact_kernel
def depart(plane: PlaneArguments, vector: Array, translation: Array, off: Array, slopes: Array) -> None:
    """Fill residuals (3,) of a pose from the plane, in standard uncertainties, and their derivatives (3, 6)."""
    rotation, slope, q = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    turned(vector, rotation, slope)
    square = 0.0
    for k in range(3):
        q[k] = rotation[k, 0] * plane.tip[0] + rotation[k, 1] * plane.tip[1] + rotation[k, 2] * plane.tip[2]
        square += (q[k] + translation[k]) ** 2
    std = np.sqrt(plane.offset_variance_m2 + plane.lever_rad**2 * square)
    off[0] = -plane.distance_m
    for k in range(3):
        off[0] += plane.normal[k] * (q[k] + translation[k])
        slopes[0, 3 + k] = plane.normal[k]
    slope_by_turn(plane.normal, q, slope, slopes[0, :3])
    off[0] /= std
    for k in range(6):
        slopes[0, k] /= std
    normal = plane.tip_normal
    for k in range(3):
        q[k] = rotation[k, 0] * normal[0] + rotation[k, 1] * normal[1] + rotation[k, 2] * normal[2]
    for i in range(2):
        across = plane.across[i]
        off[1 + i] = (across[0] * q[0] + across[1] * q[1] + across[2] * q[2]) / plane.tilt_std_rad
        slope_by_turn(across, q, slope, slopes[1 + i, :3])
        for k in range(3):
            slopes[1 + i, k] /= plane.tilt_std_rad
            slopes[1 + i, 3 + k] = 0.0


@dataclass(frozen=True)
class PlaneOfMotion:
    """The tip moves in a plane of the rod-base frame and turns about its normal only.

    `normal` (3,) of length 1 and a point of the plane `through_m` (3,), in the rod-base frame. `offset_std_m` and
    `tilt_std_rad` are the standard uncertainties of the distance from the plane and of the rotation out of it.
    """

    normal: Array
    through_m: Array
    offset_std_m: float
    tilt_std_rad: float
    board_in_tip: RigidTransform
    camera_in_base: RigidTransform

    @cached_property
    def arguments(self) -> PlaneArguments:
        """The plane as the kernels take it."""
        camera, board = self.camera_in_base, self.board_in_tip
        tip = -board.rotation.T @ board.translation_m
        constant = self.offset_std_m**2 + camera.translation_std_m**2 + board.translation_std_m**2
        return PlaneArguments(
            tip=np.ascontiguousarray(tip),
            # The normal fixed to the tip: equal to that of the plane while the tip rotates about it only.
            tip_normal=np.ascontiguousarray(board.rotation.T @ self.normal),
            normal=np.ascontiguousarray(camera.rotation.T @ self.normal),
            across=np.ascontiguousarray(self._across @ camera.rotation),
            distance_m=float(self.normal @ (self.through_m - camera.translation_m)),
            offset_variance_m2=float(constant + (board.rotation_std_rad * np.linalg.norm(tip)) ** 2),
            lever_rad=float(camera.rotation_std_rad),
            tilt_std_rad=float(np.sqrt(self.tilt_std_rad**2 + camera.rotation_std_rad**2 + board.rotation_std_rad**2)),
        )

    @property
    def _across(self) -> Array:
        """Two directions (2, 3) in the plane."""
        first = np.cross(self.normal, np.eye(3)[np.argmin(np.abs(self.normal))])
        first /= np.linalg.norm(first)
        return np.stack([first, np.cross(self.normal, first)])
