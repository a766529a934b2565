"""Cross-validation of a DLT calibration: held-out points, or views, are reconstructed from the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.dlt import DLTError, calibrate, reconstruct, undistort
from calibration.multiview_pose import fit_rigid
from calibration.vision.board import Board
from calibration.vision.lens import Lens
from model.arrays import Array

_LEAST_STAYING = 8
# Corners of a view that say something of the board's shape.
_LEAST_SHAPE = 6


@dataclass(frozen=True)
class PointObservations:
    """Observations of control points by one camera: names, `world_m` (n, 3), `pixels` (n, 2), and its lens if known."""

    names: tuple[str, ...]
    world_m: Array
    pixels: Array
    lens: Lens | None = None


@dataclass(frozen=True)
class CrossValidation:
    """Errors of the held-out points: distances [m], or pixels with only one camera; `edges_m` of boards."""

    errors_m: Array
    errors_px: Array
    edges_m: Array


def leave_out(
    cameras: Sequence[PointObservations], groups: Mapping[str, Sequence[str]], board: Board | None = None
) -> CrossValidation:
    """Leave each group of points out of every camera's calibration and reconstruct it.

    With a `board` each group is its corners, in their order, in one view: what is compared is the board's own shape,
    the view's place being a result of the very calibration. Of a view of which several cameras see only a few corners,
    too few or in a line, nothing is compared. Groups without which a camera is undetermined are passed over.
    """
    errors_m, errors_px, edges_m = [], [], []
    for points in groups.values():
        out = set(points)
        fitted = []
        for camera in cameras:
            stays = np.array([name not in out for name in camera.names])
            if stays.sum() < _LEAST_STAYING:
                continue
            try:
                dlt = calibrate(camera.world_m[stays], camera.pixels[stays], camera.lens)
            except DLTError:
                continue
            fitted.append((camera, dlt, {name: k for k, name in enumerate(camera.names) if name in out}))
        if len(cameras) == 1:
            for camera, dlt, at in fitted:
                rows = list(at.values())
                seen = camera.pixels[rows] if camera.lens is None else undistort(camera.pixels[rows], camera.lens)
                errors_px += np.linalg.norm(seen - dlt.project(camera.world_m[rows]), axis=1).tolist()
            continue
        shared = [name for name in points if sum(name in at for _, _, at in fitted) > 1]
        found: dict[str, Array] = {}
        for looking in {tuple(i for i, (_, _, at) in enumerate(fitted) if name in at) for name in shared}:
            those = [n for n in shared if tuple(i for i, (_, _, at) in enumerate(fitted) if n in at) == looking]
            pixels = [fitted[i][0].pixels[[fitted[i][2][n] for n in those]] for i in looking]
            try:
                made = reconstruct([fitted[i][1] for i in looking], pixels)
            except DLTError:
                continue
            found |= dict(zip(those, made.m, strict=True))
        if board is None:
            for name, place in found.items():
                camera, _, at = next(item for item in fitted if name in item[2])
                errors_m.append(float(np.linalg.norm(place - camera.world_m[at[name]])))
        elif (which := np.array([k for k, name in enumerate(points) if name in found], dtype=int)).size:
            shape, places = board.corners_m[which], np.array([found[points[k]] for k in which])
            if len(which) < _LEAST_SHAPE or not np.ptp(shape[:, :2], axis=0).min() > 0:
                continue
            rotation, shift = fit_rigid(shape, places)
            errors_m += np.linalg.norm(places - shape @ rotation.T - shift, axis=1).tolist()
            ends = np.searchsorted(which, board.edges[np.isin(board.edges, which).all(axis=1)])
            edges_m += np.linalg.norm(places[ends[:, 1]] - places[ends[:, 0]], axis=1).tolist()
    return CrossValidation(np.array(errors_m), np.array(errors_px), np.array(edges_m))
