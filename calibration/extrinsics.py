"""Extrinsic calibration of several cameras from simultaneous views of a board (bundle adjustment)."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.optimize import least_squares

from calibration.camera import CalibrationError
from calibration.corner_search import SeenCorners, orderings
from calibration.vision.board import Board
from calibration.vision.lens import Lens
from calibration.vision.pose import solutions
from calibration.vision.transforms import RigidTransform
from model.arrays import Array

Sightings = Mapping[str, SeenCorners]

# Two estimates of one relative pose agree within this: rotation [rad], and translation as a share of the distance.
_AGREE = 0.05
_OUTLYING = 3.0
_LEAST_VIEWS = 2


@dataclass(frozen=True)
class CameraSightings:
    """One camera: its lens, and the corners that it saw in each view, by the view's key."""

    name: str
    lens: Lens
    corners: Sightings


@dataclass(frozen=True)
class ExtrinsicCalibration:
    """Poses in the first camera's frame: the other cameras' and the board's in each view.

    `covariance` (6 (cameras - 1 + views), ..) is that of rotation vectors and translations of the inverse cameras
    (first camera's frame to theirs), then of the boards, in the order of the mappings. `corners` are each camera's
    in the board's order; `residuals_px` (n, 2) measured minus projected, by camera and view.
    """

    board: Board
    cameras: dict[str, RigidTransform]
    boards: dict[str, RigidTransform]
    corners: dict[str, dict[str, SeenCorners]]
    residuals_px: dict[str, dict[str, Array]]
    covariance: Array
    left_out: tuple[tuple[str, str], ...] = ()

    @property
    def rms_px(self) -> float:
        """Root mean square distance over all corners."""
        rest = np.concatenate([r for views in self.residuals_px.values() for r in views.values()])
        return float(np.sqrt(np.mean(np.sum(rest**2, axis=1))))

    def view_rms_px(self, view: str) -> float:
        """Root mean square distance of one view over its cameras."""
        rest = np.concatenate([views[view] for views in self.residuals_px.values() if view in views])
        return float(np.sqrt(np.mean(np.sum(rest**2, axis=1))))

    def in_world(
        self, view: str, board_in_world: RigidTransform
    ) -> tuple[dict[str, RigidTransform], dict[str, RigidTransform]]:
        """Cameras and boards in the world, from a known pose of the board of `view`."""
        to_world = board_in_world @ self.boards[view].inverse()
        return (
            {name: to_world @ camera for name, camera in self.cameras.items()},
            {key: to_world @ board for key, board in self.boards.items()},
        )

    def placement_covariance(self, camera: str, view: str, board_in_world: RigidTransform) -> Array:
        """Covariance (6, 6) of a camera's translation [m] and rotation [rad, about its own origin, world axes]."""
        names, keys = list(self.cameras), list(self.boards)
        at = [6 * (len(names) - 1 + keys.index(view)) + k for k in range(6)]
        own = names.index(camera)
        if own:
            at = [6 * (own - 1) + k for k in range(6)] + at
        start = np.concatenate(([*_vector(self.cameras[camera].inverse())] if own else [], _vector(self.boards[view])))

        def place(values: Array) -> RigidTransform:
            from_camera = _rigid(values[:6]).inverse() if own else self.cameras[camera]
            return board_in_world @ _rigid(values[-6:]).inverse() @ from_camera

        centre = place(start)
        slope = np.empty((6, len(start)))
        for k, step in enumerate(np.where(np.arange(len(start)) % 6 < 3, 1e-6, 1e-7)):
            moved = place(start + step * (np.arange(len(start)) == k))
            off = moved.rotation @ centre.rotation.T
            turn = np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]]) / 2
            slope[:, k] = np.concatenate([moved.translation_m - centre.translation_m, turn]) / step
        return np.asarray(slope @ self.covariance[np.ix_(at, at)] @ slope.T)

    def baseline_m(self, camera: str, other: str) -> tuple[float, float]:
        """Distance [m] of the centres of two cameras and its standard uncertainty."""
        names = [name for name in (camera, other) if name != next(iter(self.cameras))]
        order = list(self.cameras)
        at = [6 * (order.index(name) - 1) + k for name in names for k in range(6)]
        start = np.concatenate([_vector(self.cameras[name].inverse()) for name in names])

        def distance(values: Array) -> float:
            moved = {name: _rigid(v).inverse() for name, v in zip(names, values.reshape(-1, 6), strict=True)}
            ends = [moved.get(name, self.cameras[name]).translation_m for name in (camera, other)]
            return float(np.linalg.norm(ends[1] - ends[0]))

        steps = np.diag(np.where(np.arange(len(start)) % 6 < 3, 1e-6, 1e-7))
        slope = np.array([(distance(start + step) - distance(start - step)) / (2 * step.sum()) for step in steps])
        return distance(start), float(np.sqrt(slope @ self.covariance[np.ix_(at, at)] @ slope))


def locate(cameras: Sequence[CameraSightings], board: Board) -> ExtrinsicCalibration:
    """Find cameras and boards from simultaneous views by bundle adjustment.

    On a board that looks the same upside down the corners' order is chosen so that the cameras agree.

    Raises:
        CalibrationError: two cameras share too few views, or their views contradict each other.
    """
    poses = {c.name: {key: _poses(board, c.lens, seen) for key, seen in c.corners.items()} for c in cameras}
    poses = {name: {key: found for key, found in views.items() if found} for name, views in poses.items()}
    placed, chosen = _chain([c.name for c in cameras], poses)
    start = _assemble(cameras, board, placed, chosen)
    dropped: list[tuple[str, str]] = []
    while True:
        found = replace(_refine(cameras, start), left_out=tuple(dropped))
        rms = {key: found.view_rms_px(key) for key in found.boards}
        usual, worst = float(np.median(list(rms.values()))), max(rms, key=lambda key: rms[key])
        if rms[worst] <= _OUTLYING * usual or len(rms) <= _LEAST_VIEWS:
            return found
        dropped.append((worst, f"residual {rms[worst]:.2f} px where the median is {usual:.2f} px"))
        for views in chosen.values():
            views.pop(worst, None)
        start = _assemble(cameras, board, found.cameras, chosen)


@dataclass(frozen=True)
class _BoardView:
    """One possible pose of the board in a camera frame, with the corners in the matching order."""

    pose: RigidTransform
    corners: SeenCorners
    misfit: float


def _poses(board: Board, lens: Lens, corners: SeenCorners) -> list[_BoardView]:
    """Every possible pose: both sides of the planar flip and every symmetry of the board."""
    found = []
    for seen in orderings(board, corners):
        poses = solutions(board.corners_m[seen.which], seen.px, lens)
        found += [_BoardView(pose.rigid, seen, pose.misfit) for pose in poses]
    best = min((seen.misfit for seen in found), default=0.0)
    # Keep the other side of a flip only if it fits nearly as well.
    return [seen for seen in found if seen.misfit <= 2 * best + 30]


def _chain(
    names: Sequence[str], poses: Mapping[str, Mapping[str, list[_BoardView]]]
) -> tuple[dict[str, RigidTransform], dict[str, dict[str, _BoardView]]]:
    """Each camera in the first one's frame, along the pairs that share most views, and one pose for each sighting."""
    first = names[0]
    placed = {first: RigidTransform(np.eye(3), np.zeros(3))}
    chosen: dict[str, dict[str, _BoardView]] = {first: {}}
    # Alone, the first camera has nothing to agree with: the best pose is taken.
    if len(names) == 1:
        chosen[first] = {key: found[0] for key, found in poses[first].items()}
    while len(placed) < len(names):
        pairs = [(len(poses[a].keys() & poses[b].keys()), a, b) for a in placed for b in names if b not in placed]
        shared, a, b = max(pairs, key=lambda pair: pair[0])
        if shared < _LEAST_VIEWS:
            raise CalibrationError(
                f"cameras {a} and {b} share {shared} views of the board, at least {_LEAST_VIEWS} are needed: are the "
                "pictures of one moment named by the same number?"
            )
        relative, picks = _agree(a, b, poses[a], poses[b], chosen[a])
        placed[b] = placed[a] @ relative
        chosen[b] = {}
        for key, (seen_a, seen_b) in picks.items():
            chosen[a].setdefault(key, seen_a)
            chosen[b][key] = seen_b
    for name in names:
        for key, found in poses[name].items():
            chosen[name].setdefault(key, found[0])
    return placed, chosen


def _agree(
    a: str,
    b: str,
    of_a: Mapping[str, list[_BoardView]],
    of_b: Mapping[str, list[_BoardView]],
    fixed: Mapping[str, _BoardView],
) -> tuple[RigidTransform, dict[str, tuple[_BoardView, _BoardView]]]:
    """Camera b in a's frame: the estimate that most views agree with, and what each view then was."""
    options: dict[str, list[tuple[RigidTransform, _BoardView, _BoardView]]] = {}
    for key in of_a.keys() & of_b.keys():
        first = [fixed[key]] if key in fixed else of_a[key]
        options[key] = [(p.pose @ q.pose.inverse(), p, q) for p, q in itertools.product(first, of_b[key])]
    candidates = [relative for listed in options.values() for relative, _, _ in listed]

    def nearest(relative: RigidTransform, key: str) -> tuple[float, tuple[RigidTransform, _BoardView, _BoardView]]:
        return min(((_distance(relative, o[0]), o) for o in options[key]), key=lambda pair: pair[0])

    score = [float(np.median([nearest(relative, key)[0] for key in options])) for relative in candidates]
    best = candidates[int(np.argmin(score))]
    agreeing = {key: found[1] for key in options if (found := nearest(best, key))[0] < _AGREE * 4}
    if len(agreeing) < max(_LEAST_VIEWS, len(options) // 2):
        raise CalibrationError(
            f"the views of cameras {a} and {b} contradict each other ({len(agreeing)} of {len(options)} agree): are "
            "pictures with the same number of the same moment, and is the board's square right?"
        )
    translation = np.median([found[0].translation_m for found in agreeing.values()], axis=0)
    return RigidTransform(best.rotation, translation), {key: (found[1], found[2]) for key, found in agreeing.items()}


def _distance(a: RigidTransform, b: RigidTransform) -> float:
    """Distance of two relative poses: angle [rad] plus relative translation."""
    turn = float(np.arccos(np.clip((np.sum(a.rotation * b.rotation) - 1) / 2, -1, 1)))
    length = max(float(np.linalg.norm(a.translation_m)), 1e-3)
    return turn + float(np.linalg.norm(a.translation_m - b.translation_m)) / length


def _assemble(
    cameras: Sequence[CameraSightings],
    board: Board,
    placed: Mapping[str, RigidTransform],
    chosen: Mapping[str, Mapping[str, _BoardView]],
) -> ExtrinsicCalibration:
    """Boards in the first camera's frame, each from the camera that saw it best, and the residuals that this gives."""
    boards: dict[str, RigidTransform] = {}
    for key in sorted({key for views in chosen.values() for key in views}):
        sights = [(name, chosen[name][key]) for name in placed if key in chosen.get(name, {})]
        name, seen = min(sights, key=lambda pair: pair[1].misfit)
        boards[key] = placed[name] @ seen.pose
    corners = {c.name: {key: seen.corners for key, seen in chosen[c.name].items()} for c in cameras}
    size = 6 * (len(cameras) - 1 + len(boards))
    found = ExtrinsicCalibration(board, dict(placed), boards, corners, {}, np.zeros((size, size)))
    return replace(found, residuals_px=_residuals(cameras, found))


def _residuals(cameras: Sequence[CameraSightings], at: ExtrinsicCalibration) -> dict[str, dict[str, Array]]:
    found: dict[str, dict[str, Array]] = {}
    for camera in cameras:
        to_camera = at.cameras[camera.name].inverse()
        found[camera.name] = {}
        for key, seen in at.corners[camera.name].items():
            values = _vector(to_camera @ at.boards[key])
            projected = camera.lens.project(at.board.corners_m[seen.which], values[:3], values[3:])
            found[camera.name][key] = seen.px - projected
    return found


def _refine(cameras: Sequence[CameraSightings], start: ExtrinsicCalibration) -> ExtrinsicCalibration:
    """Least squares of all residuals over the cameras (but the first) and the boards."""
    names, keys = [c.name for c in cameras], list(start.boards)
    rows = [
        (i, keys.index(key), start.corners[c.name][key])
        for i, c in enumerate(cameras)
        for key in keys
        if key in start.corners[c.name]
    ]
    size = 6 * (len(names) - 1 + len(keys))
    ends = np.cumsum([0, *(2 * len(seen.which) for _, _, seen in rows)])

    def both(x: Array) -> tuple[Array, Array]:
        rest, slope = np.empty(ends[-1]), np.zeros((ends[-1], size))
        for r, (i, k, corners) in enumerate(rows):
            own = slice(ends[r], ends[r + 1])
            at = 6 * (len(names) - 1 + k)
            v = x[at : at + 6]
            c = x[6 * (i - 1) : 6 * i] if i else np.zeros(6)
            made = cv2.composeRT(v[:3], v[3:], c[:3], c[3:])
            turn, shift, drdr1, drdt1, drdr2, drdt2, dtdr1, dtdt1, dtdr2, dtdt2 = made
            place = np.asarray(turn, np.float64).ravel(), np.asarray(shift, np.float64).ravel()
            points = start.board.corners_m[corners.which]
            seen, jac = cameras[i].lens.project_with_jacobian(points, *place)
            rest[own] = (seen - corners.px).ravel()
            slope[own, at : at + 6] = jac @ np.block([[drdr1, drdt1], [dtdr1, dtdt1]])
            if i:
                slope[own, 6 * (i - 1) : 6 * i] = jac @ np.block([[drdr2, drdt2], [dtdr2, dtdt2]])
        return rest, slope

    x0 = np.concatenate(
        [_vector(start.cameras[n].inverse()) for n in names[1:]] + [_vector(start.boards[k]) for k in keys]
    )
    solved = least_squares(lambda x: both(x)[0], x0, jac=lambda x: both(x)[1], method="trf", x_scale="jac")
    x = solved.x
    freedom = max(len(solved.fun) - size, 1)
    covariance = float(solved.fun @ solved.fun) / freedom * np.linalg.pinv(solved.jac.T @ solved.jac, hermitian=True)
    placed = {names[0]: start.cameras[names[0]]}
    placed |= {n: _rigid(x[6 * i : 6 * i + 6]).inverse() for i, n in enumerate(names[1:])}
    offset = 6 * (len(names) - 1)
    boards = {k: _rigid(x[offset + 6 * j : offset + 6 * j + 6]) for j, k in enumerate(keys)}
    found = replace(start, cameras=placed, boards=boards, covariance=np.asarray(covariance))
    return replace(found, residuals_px=_residuals(cameras, found))


def _vector(pose: RigidTransform) -> Array:
    return np.concatenate([cv2.Rodrigues(pose.rotation)[0].ravel(), pose.translation_m])


def _rigid(values: Array) -> RigidTransform:
    return RigidTransform.from_vectors(values[:3], values[3:])
