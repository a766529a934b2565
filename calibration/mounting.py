"""How the board is mounted: its place in the tip frame, from views of the straight arm and of its cap turned.

Turning the cap about the arm's central axis shows where that axis runs through the board, and needs no knowledge of the
camera's place. How far up the axis the tip is, and which way its x axis points, only the straight arm shows, whose tip
is known in the camera's frame as well as the camera's place is. Both are put into one least-squares problem.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import least_squares

from calibration.camera import CalibrationError
from calibration.rotation_vectors import left_jacobian
from calibration.views import View
from calibration.vision.board import Board
from calibration.vision.corners import Corners
from calibration.vision.lens import Lens
from calibration.vision.pose import Pose, solutions
from calibration.vision.transforms import RigidTransform
from model.arrays import Array

_LEAST_STD_PX = 0.01
# The other side of the planar flip is used only if it fits nearly as well.
_FLIP = 1.5
_OUTLYING = 4.0


@dataclass(frozen=True)
class MountedView:
    """One view that was used; the residuals are how far its own pose is from the common one, at the board's centre."""

    name: str
    sha256: str
    turned: bool
    angle_rad: float
    residual_m: float
    residual_rad: float


@dataclass(frozen=True)
class Mounting:
    """The board in the tip frame, with covariance (6, 6) of translation [m] and rotation [rad, tip axes]."""

    board_in_tip: RigidTransform
    covariance: Array
    views: tuple[MountedView, ...]
    left_out: tuple[tuple[str, str, str], ...] = ()
    """Name, reason and hash of every view that was not used."""


@dataclass(frozen=True)
class _MountingView:
    view: View
    turned: bool
    corners: Corners
    poses: tuple[Pose, ...]


def mount(
    straight: Sequence[View],
    turned: Sequence[View],
    board: Board,
    lens: Lens,
    tip_in_camera: RigidTransform,
    stated: RigidTransform,
) -> Mounting:
    """Find the board in the tip frame.

    `tip_in_camera` is where the tip of the straight arm is before the camera, with its uncertainty (about the tip);
    `stated` is roughly where the board is, and decides where a picture alone cannot.

    Raises:
        CalibrationError: no view of the straight arm shows the board.
    """
    sights, left_out = [], []
    for views, is_turned in ((straight, False), (turned, True)):
        for view in views:
            seeds = board.find(view.image)
            corners = None if seeds is None else board.refine(view.image, seeds)
            if corners is None:
                left_out.append((view.name, "the board was not found", view.sha256))
                continue
            poses = solutions(corners.of(board.corners_m), corners.px, lens, corners.covariance, corners.unexplained)
            if poses:
                sights.append(_MountingView(view, is_turned, corners, poses))
            else:
                left_out.append((view.name, "its corners give no pose", view.sha256))
    if all(sight.turned for sight in sights):
        raise CalibrationError(
            "no view of the straight arm shows the board: without one, neither the tip's height nor its x axis is known"
        )
    while True:
        found = _solve(sights, board, lens, tip_in_camera, stated)
        misses = np.array([v.residual_m for v in found.views])
        worst = int(np.argmax(misses))
        few = sum(s.turned == sights[worst].turned for s in sights) < 3
        if few or misses[worst] <= _OUTLYING * max(float(np.median(misses)), 2e-5):
            return Mounting(found.board_in_tip, found.covariance, found.views, tuple(left_out))
        why = f"{1e3 * misses[worst]:.2f} mm off where the median is {1e3 * float(np.median(misses)):.2f} mm"
        dropped = sights.pop(worst)
        left_out.append((dropped.view.name, why, dropped.view.sha256))


def _solve(
    sights: Sequence[_MountingView], board: Board, lens: Lens, prior: RigidTransform, stated: RigidTransform
) -> Mounting:
    chosen = [_likely(sight, prior, stated) for sight in sights]
    first = next(pose for sight, pose in zip(sights, chosen, strict=True) if not sight.turned)
    start = prior.inverse() @ first.rigid
    angles = [_turn(prior, pose.rigid, start) for s, pose in zip(sights, chosen, strict=True) if s.turned]
    std_px = max(
        float(np.sqrt(np.mean([np.mean(pose.residuals_px**2) for pose in chosen]))) * _freedom(chosen), _LEAST_STD_PX
    )
    stds = np.array([max(prior.rotation_std_rad, 1e-7)] * 3 + [max(prior.translation_std_m, 1e-8)] * 3)
    points = [sight.corners.of(board.corners_m) for sight in sights]

    def poses(x: Array) -> list[RigidTransform]:
        # The tip moves about itself, in the camera's axes.
        tip = RigidTransform(RigidTransform.from_vectors(stds[:3] * x[:3], (0, 0, 0)).rotation @ prior.rotation,
                    prior.translation_m + stds[3:] * x[3:6])  # fmt: skip
        mounted = RigidTransform.from_vectors(x[6:9], x[9:12])
        left = iter(x[12:])
        return [tip @ _about_z(next(left) if s.turned else 0.0) @ mounted for s in sights]

    def rest(x: Array) -> Array:
        found = [x[:6]]
        for sight, at, pose in zip(sights, points, poses(x), strict=True):
            seen = lens.project(at, cv2.Rodrigues(pose.rotation)[0].ravel().astype(np.float64), pose.translation_m)
            found.append((seen - sight.corners.px).ravel() / std_px)
        return np.concatenate(found)

    x0 = np.concatenate([np.zeros(6), cv2.Rodrigues(start.rotation)[0].ravel(), start.translation_m, angles])
    solved = least_squares(rest, x0, jac="3-point", x_scale="jac")
    x = solved.x
    squares = float(solved.fun @ solved.fun)
    scale = max(squares / max(len(solved.fun) - len(x), 1), 1.0)
    covariance = np.linalg.pinv(solved.jac.T @ solved.jac, hermitian=True) * scale
    mounted = RigidTransform.from_vectors(x[6:9], x[9:12])
    # Rotation vector -> turn in the tip's axes about the board's centre.
    slope = np.zeros((6, 6))
    slope[:3, 3:] = np.eye(3)
    slope[3:, :3] = left_jacobian(x[6:9])
    own = slope @ covariance[6:12, 6:12] @ slope.T
    stated_std = float(np.sqrt(np.trace(own[:3, :3]) / 3)), float(np.sqrt(np.trace(own[3:, 3:]) / 3))
    made = RigidTransform(mounted.rotation, mounted.translation_m, *stated_std)
    left = iter(x[12:])
    views = tuple(
        MountedView(
            s.view.name,
            s.view.sha256,
            s.turned,
            float(next(left)) if s.turned else 0.0,
            float(np.linalg.norm(common.translation_m - pose.translation_m)),
            _angle(common.rotation, pose.rigid.rotation),
        )
        for s, common, pose in zip(sights, poses(x), chosen, strict=True)
    )
    return Mounting(made, np.asarray(own), views)


def _likely(sight: _MountingView, prior: RigidTransform, stated: RigidTransform) -> Pose:
    """The pose of a view: the better one, or of two similar ones the one nearer to the stated mounting."""
    best = sight.poses[0]
    near = [pose for pose in sight.poses if pose.misfit <= _FLIP * best.misfit]

    def off(pose: Pose) -> float:
        expected = prior @ _about_z(_turn(prior, pose.rigid, stated) if sight.turned else 0.0) @ stated
        return _angle(expected.rotation, pose.rigid.rotation)

    return min(near, key=off)


def _turn(prior: RigidTransform, board_in_camera: RigidTransform, mounted: RigidTransform) -> float:
    """Angle [rad] about the tip's z axis that aligns the mounted board with its measured pose."""
    r = prior.rotation.T @ board_in_camera.rotation @ mounted.rotation.T
    return float(np.arctan2(r[1, 0] - r[0, 1], r[0, 0] + r[1, 1]))


def _about_z(angle_rad: float) -> RigidTransform:
    return RigidTransform.from_vectors((0.0, 0.0, angle_rad), (0.0, 0.0, 0.0))


def _angle(a: Array, b: Array) -> float:
    return float(np.arccos(np.clip((np.sum(a * b) - 1) / 2, -1, 1)))


def _freedom(poses: Sequence[Pose]) -> float:
    """Factor that corrects the views' residuals for the six degrees of freedom of each pose."""
    count = float(np.mean([pose.residuals_px.size for pose in poses]))
    return float(np.sqrt(count / (count - 6)))
