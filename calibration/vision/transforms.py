"""Named rigid transforms with their uncertainty, and how points and covariances pass through them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from calibration.rotation_vectors import cross_matrix
from model.arrays import Array

_UNIT = np.eye(3)


@dataclass(frozen=True)
class RigidTransform:
    """A frame in its parent: a point x of the frame is `rotation` x + `translation_m` in the parent.

    `rotation` (3, 3), `translation_m` (3,). The standard uncertainties are per axis: of the origin [m], and of the
    orientation [rad] about the frame's own origin.
    """

    rotation: Array
    translation_m: Array
    translation_std_m: float = 0.0
    rotation_std_rad: float = 0.0

    @classmethod
    def from_vectors(
        cls,
        rotation_vector_rad: Array | tuple[float, float, float],
        translation_m: Array | tuple[float, float, float],
        translation_std_m: float = 0.0,
        rotation_std_rad: float = 0.0,
    ) -> RigidTransform:
        """Build from a rotation vector (3,) [rad] and a translation (3,) [m]."""
        rotation, _ = cv2.Rodrigues(np.asarray(rotation_vector_rad, dtype=np.float64))
        return cls(
            np.asarray(rotation, dtype=np.float64),
            np.asarray(translation_m, dtype=np.float64),
            translation_std_m,
            rotation_std_rad,
        )

    def apply(self, points_m: Array) -> Array:
        """Points (..., 3) of this frame in the parent frame."""
        return points_m @ self.rotation.T + self.translation_m

    def inverse(self) -> RigidTransform:
        """Return the parent in this frame, without uncertainty."""
        return RigidTransform(self.rotation.T.copy(), -self.rotation.T @ self.translation_m)

    def __matmul__(self, inner: RigidTransform) -> RigidTransform:
        """Return `inner`'s frame in this frame's parent, without uncertainty."""
        return RigidTransform(self.rotation @ inner.rotation, self.apply(inner.translation_m))

    def transport_pose(self, pose: RigidTransform, covariance: Array) -> tuple[RigidTransform, Array]:
        """Carry a pose and its covariance (6, 6) into the parent, adding this transform's own uncertainty.

        Covariances are of the translation [m] and of a small rotation [rad] about the axes of the outer frame.
        """
        turn = np.zeros((6, 6))
        turn[:3, :3] = turn[3:, 3:] = self.rotation
        own = self.error_covariance(self.rotation @ pose.translation_m)
        return self @ pose, np.asarray(turn @ covariance @ turn.T + own)

    def error_covariance(self, arm_m: Array) -> Array:
        """Covariances (.., 6, 6) that the own uncertainty gives poses at the end of levers (.., 3) from the origin."""
        lever = np.empty((*arm_m.shape[:-1], 6, 3))
        lever[..., :3, :], lever[..., 3:, :] = -cross_matrix(arm_m), _UNIT
        covariance = self.rotation_std_rad**2 * lever @ np.swapaxes(lever, -1, -2)
        covariance[..., :3, :3] += self.translation_std_m**2 * _UNIT
        return np.asarray(covariance)
