"""Direct linear transformation (Abdel-Aziz and Karara 1971): 11 coefficients per camera, points from several cameras.

The picture of a point (X, Y, Z) lies at

    u = (L1 X + L2 Y + L3 Z + L4) / (L9 X + L10 Y + L11 Z + 1)
    v = (L5 X + L6 Y + L7 Z + L8) / (L9 X + L10 Y + L11 Z + 1)

once the lens's distortion is taken out of the measured pixels. Coefficients come linearly from at least six control
points that are not in one plane (Hartley's normalisation, then the singular vector), and are then refined so that the
squared residuals in the picture are least.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.vision.lens import Lens
from calibration.vision.transforms import RigidTransform
from model.arrays import Array

LEAST_POINTS = 6
_STEPS = 50
_CONVERGED = 1e-12
# Control points whose thickness is below this share of their extent count as lying in a plane.
_FLAT = 1e-3
_USUAL_STD_PX = 0.05
# Turn [rad] and shift [m] by which coefficients are differentiated.
_SLIP = 1e-6


class DLTError(Exception):
    """The points do not determine the result; the message has the reason."""


@dataclass(frozen=True)
class DLT:
    """One camera: `coefficients` (11,) L1 to L11, world in metres, undistorted pixels.

    `covariance` (11, 11) of the coefficients, `residuals_px` (n, 2) of the control points, measured minus projected;
    `lens` is the distortion that is taken out first, None where the pictures have none.
    """

    coefficients: Array
    covariance: Array
    residuals_px: Array
    lens: Lens | None = None

    @classmethod
    def of_camera(cls, lens: Lens, camera_in_world: RigidTransform) -> DLT:
        """Return the coefficients of a camera from its lens and its pose, with the uncertainty of the pose."""
        coefficients = _placed(lens, camera_in_world)
        slips = [(np.eye(3)[k] * _SLIP, np.zeros(3)) for k in range(3)]
        slips += [(np.zeros(3), np.eye(3)[k] * _SLIP) for k in range(3)]
        stds = [camera_in_world.rotation_std_rad] * 3 + [camera_in_world.translation_std_m] * 3
        columns = [
            (_placed(lens, _slipped(camera_in_world, *slip)) - coefficients) * (std / _SLIP)
            for slip, std in zip(slips, stds, strict=True)
        ]
        by_place = np.column_stack(columns)
        return cls(coefficients, by_place @ by_place.T, np.zeros((0, 2)), lens)

    @property
    def matrix(self) -> Array:
        """Projection matrix (3, 4) with the last entry 1."""
        return np.append(self.coefficients, 1.0).reshape(3, 4)

    @property
    def rms_px(self) -> float:
        """Root mean square residual of the control points."""
        return float(np.sqrt(np.mean(np.sum(self.residuals_px**2, axis=1)))) if len(self.residuals_px) else 0.0

    @property
    def centre_m(self) -> Array:
        """Projection centre (3,): the null space of the matrix."""
        matrix = self.matrix
        return np.asarray(-np.linalg.solve(matrix[:, :3], matrix[:, 3]))

    def project(self, points_m: Array) -> Array:
        """Undistorted pixels (n, 2) of world points (n, 3)."""
        return _project(self.matrix, points_m)

    def by_coefficients(self, points_m: Array) -> Array:
        """Derivative (2 n, 11) of the pixels of world points (n, 3) by the coefficients; rows u0, v0, u1, ..."""
        return _by_coefficients(self.matrix, points_m)

    def undistorted(self, pixels: Array) -> Array:
        """Undistorted measured pixels (n, 2)."""
        return pixels if self.lens is None else undistort(pixels, self.lens)


def decompose(dlt: DLT) -> tuple[Lens, RigidTransform]:
    """Decompose coefficients into intrinsics and camera pose (RQ decomposition); the lens has no skew."""
    matrix = dlt.matrix
    # RQ by QR of the reversed matrix; signs such that the focal lengths are positive.
    q, r = np.linalg.qr(np.flipud(matrix[:, :3]).T)
    upper, rotation = np.flipud(np.fliplr(r.T)), np.flipud(q.T)
    signs = np.diag(np.sign(np.diag(upper)))
    upper, rotation = upper @ signs, signs @ rotation
    if np.linalg.det(rotation) < 0:
        rotation = -rotation
    upper = upper / upper[2, 2]
    lens = Lens.of(upper[0, 0], upper[1, 1], upper[0, 2], upper[1, 2])
    return lens, RigidTransform(np.asarray(rotation.T), dlt.centre_m)


def _placed(lens: Lens, camera_in_world: RigidTransform) -> Array:
    world_in_camera = camera_in_world.inverse()
    return _coefficients(lens.matrix @ np.column_stack([world_in_camera.rotation, world_in_camera.translation_m]))


def _slipped(frame: RigidTransform, turn_rad: Array, shift_m: Array) -> RigidTransform:
    return RigidTransform(
        RigidTransform.from_vectors(turn_rad, shift_m).rotation @ frame.rotation, frame.translation_m + shift_m
    )


def undistort(pixels: Array, lens: Lens) -> Array:
    """Remove the lens distortion from pixels (n, 2)."""
    matrix = lens.matrix
    return lens.rays(pixels) @ matrix[:2, :2].T + matrix[:2, 2]


def calibrate(control_points_m: Array, pixels: Array, lens: Lens | None = None, std_px: float | None = None) -> DLT:
    """Coefficients from control points (n, 3) [m] and where the camera saw them (n, 2) [px].

    `lens` is taken out first. `std_px` is the standard uncertainty of one pixel coordinate; if None it is
    estimated from the residuals.

    Raises:
        DLTError: fewer than six points, points in a plane, or the origin lies beside the camera.
    """
    points = np.asarray(control_points_m, dtype=np.float64)
    measured = np.asarray(pixels, dtype=np.float64)
    _check(points, measured)
    seen = measured if lens is None else undistort(measured, lens)
    start = _coefficients(_linear(points, seen))
    coefficients, residuals, jacobian = _refine(start, points, seen)
    freedom = residuals.size - 11
    if std_px is not None:
        variance = std_px**2
    elif freedom > 0:
        variance = float(residuals @ residuals) / freedom
    else:
        variance = _USUAL_STD_PX**2
    covariance = variance * np.linalg.pinv(jacobian.T @ jacobian)
    return DLT(coefficients, np.asarray(covariance), residuals.reshape(-1, 2), lens)


@dataclass(frozen=True)
class ReconstructedPoints:
    """Reconstructed points `m` (n, 3), their covariance (n, 3, 3) [m^2] and residual rms over the cameras (n,) [px]."""

    m: Array
    covariance: Array
    residual_px: Array


def reconstruct(
    cameras: Sequence[DLT], pixels: Sequence[Array], covariances: Sequence[Array] | None = None
) -> ReconstructedPoints:
    """Points from two or more cameras' pixels, each (n, 2), with covariances (n, 2, 2) where they are known.

    Linear intersection, then least squares of the residuals. The covariance holds that of the pixels and that of the
    coefficients, the latter as if it were independent at each point.

    Raises:
        DLTError: fewer than two cameras, or a point's rays do not meet in front of them.
    """
    if len(cameras) < 2 or len(cameras) != len(pixels):
        raise DLTError(f"a point needs two cameras or more, each with its pixels; here are {len(cameras)}")
    seen = np.stack([c.undistorted(np.asarray(p, dtype=np.float64)) for c, p in zip(cameras, pixels, strict=True)])
    count = seen.shape[1]
    if covariances is None:
        covariances = [np.broadcast_to(_USUAL_STD_PX**2 * np.eye(2), (count, 2, 2))] * len(cameras)
    noise = np.stack([np.asarray(c, dtype=np.float64) for c in covariances])
    matrices = [camera.matrix for camera in cameras]
    points = _meet(matrices, seen)
    total = np.empty((count, 3, 3))
    for _ in range(_STEPS):
        total, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
        for camera, matrix, uv, cov in zip(cameras, matrices, seen, noise, strict=True):
            slope = by_points(matrix, points)
            # Covariance of this camera's pixels by the uncertainty of its coefficients.
            by_own = camera.by_coefficients(points).reshape(count, 2, 11)
            weighted = slope.transpose(0, 2, 1) @ np.linalg.inv(cov + by_own @ camera.covariance @ by_own.mT)
            total += weighted @ slope
            right += np.einsum("nij,nj->ni", weighted, uv - _project(matrix, points))
        step = np.linalg.solve(total, right[:, :, None])[:, :, 0]
        points = points + step
        if np.abs(step).max() < _CONVERGED * max(1.0, float(np.abs(points).max())):
            break
    rest = np.stack([uv - _project(matrix, points) for matrix, uv in zip(matrices, seen, strict=True)])
    if not np.all(np.isfinite(rest)):
        raise DLTError("the cameras' rays do not meet")
    residual = np.sqrt(np.mean(np.sum(rest**2, axis=2), axis=0))
    return ReconstructedPoints(points, np.asarray(np.linalg.inv(total)), np.asarray(residual))


def _meet(matrices: Sequence[Array], seen: Array) -> Array:
    """Points (n, 3) that fit the cameras' linear equations best; `seen` (cameras, n, 2)."""
    rows = np.concatenate([uv[:, :, None] * m[2] - m[:2] for m, uv in zip(matrices, seen, strict=True)], axis=1)
    rows = rows / np.linalg.norm(rows[:, :, :3], axis=2, keepdims=True)
    singular = np.linalg.svd(rows[:, :, :3], compute_uv=False)
    if np.any(singular[:, 2] < 1e-6 * singular[:, 0]):
        raise DLTError("the cameras' rays are parallel: the cameras stand too close together")
    return np.asarray(-(np.linalg.pinv(rows[:, :, :3]) @ rows[:, :, 3:])[:, :, 0])


def _check(points: Array, pixels: Array) -> None:
    if points.ndim != 2 or points.shape[1] != 3 or pixels.shape != (len(points), 2):
        raise DLTError(f"control points (n, 3) need pixels (n, 2); here are {points.shape} and {pixels.shape}")
    if len(points) < LEAST_POINTS:
        raise DLTError(f"11 coefficients need at least {LEAST_POINTS} control points; here are {len(points)}")
    if not (np.all(np.isfinite(points)) and np.all(np.isfinite(pixels))):
        raise DLTError("a control point or its pixel is not a number")
    extent = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if extent[2] < _FLAT * extent[0]:
        raise DLTError("the control points lie in one plane: move the board between views, or add points out of it")


def _normaliser(points: Array) -> Array:
    """Hartley normalisation: centroid at the origin, mean distance sqrt(dimension)."""
    dimension = points.shape[1]
    centre = points.mean(axis=0)
    scale = np.sqrt(dimension) / np.mean(np.linalg.norm(points - centre, axis=1))
    similarity = np.diag(np.append(np.full(dimension, scale), 1.0))
    similarity[:dimension, dimension] = -scale * centre
    return similarity


def _linear(points: Array, pixels: Array) -> Array:
    """Projection matrix (3, 4), up to scale, by DLT: singular vector of the normalised equations."""
    to_points, to_pixels = _normaliser(points), _normaliser(pixels)
    world = np.column_stack([points, np.ones(len(points))]) @ to_points.T
    image = np.column_stack([pixels, np.ones(len(pixels))]) @ to_pixels.T
    nothing = np.zeros_like(world)
    equations = np.concatenate(
        [
            np.hstack([world, nothing, -image[:, :1] * world]),
            np.hstack([nothing, world, -image[:, 1:2] * world]),
        ]
    )
    matrix = np.linalg.svd(equations, full_matrices=False)[2][-1].reshape(3, 4)
    return np.asarray(np.linalg.inv(to_pixels) @ matrix @ to_points)


def _coefficients(matrix: Array) -> Array:
    """L1 to L11 of a projection matrix: scaled so that its last entry is 1."""
    if abs(matrix[2, 3]) < 1e-9 * np.abs(matrix[2]).max():
        raise DLTError("the origin lies beside the camera, where the 11 coefficients have no value: move the origin")
    return np.asarray((matrix / matrix[2, 3]).ravel()[:11])


def _project(matrix: Array, points: Array) -> Array:
    h = points @ matrix[:, :3].T + matrix[:, 3]
    return np.asarray(h[:, :2] / h[:, 2:])


def by_points(matrix: Array, points: Array) -> Array:
    """Derivative (n, 2, 3) of the pixels of points (n, 3), by each point."""
    h = points @ matrix[:, :3].T + matrix[:, 3]
    uv = h[:, :2] / h[:, 2:]
    return np.asarray((matrix[None, :2, :3] - uv[:, :, None] * matrix[None, 2:, :3]) / h[:, 2, None, None])


def _by_coefficients(matrix: Array, points: Array) -> Array:
    """Derivative (2 n, 11) of pixels by the coefficients; rows u0, v0, u1, ..."""
    world = np.column_stack([points, np.ones(len(points))])
    depth = world @ matrix[2]
    uv = _project(matrix, points)
    slope = np.zeros((len(points), 2, 11))
    slope[:, 0, 0:4] = world / depth[:, None]
    slope[:, 1, 4:8] = world / depth[:, None]
    slope[:, :, 8:11] = -uv[:, :, None] * (points / depth[:, None])[:, None, :]
    return slope.reshape(-1, 11)


def _refine(coefficients: Array, points: Array, pixels: Array) -> tuple[Array, Array, Array]:
    """Levenberg-Marquardt on the residuals; returns coefficients, residuals (2 n,) and derivatives (2 n, 11)."""
    # Imported here: the process that measures frames reconstructs only, and SciPy takes 0.2 s to load.
    from scipy.optimize import least_squares

    def residuals(values: Array) -> Array:
        return (_project(np.append(values, 1.0).reshape(3, 4), points) - pixels).ravel()

    def derivatives(values: Array) -> Array:
        return _by_coefficients(np.append(values, 1.0).reshape(3, 4), points)

    # The columns are scaled, because the coefficients differ by orders of magnitude.
    found = least_squares(
        residuals,
        coefficients,
        derivatives,
        method="lm",
        x_scale="jac",
        ftol=_CONVERGED,
        xtol=_CONVERGED,
        gtol=_CONVERGED,
    )
    return found.x, -found.fun, found.jac
