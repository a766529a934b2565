"""Collect views from a live camera: the operator moves the board by instructions; good views are stored."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import cv2
import numpy as np

from calibration.camera import CalibrationError
from calibration.corner_search import SeenCorners, seen_corners
from calibration.images import Image
from calibration.view_coverage import ViewCoverage, view_geometry
from calibration.views import View
from calibration.vision.board import Board, grey
from rig.config.drivers import Reality
from rig.config.schema import RigConfig
from rig.hardware.cameras.base import open_camera
from runs.overwriting import replacing

_STILL_SHARE = 0.002
"""Largest corner motion between two pictures of a board at rest, as a share of the width."""
CAMERA_TIMEOUT_S = 5.0
_MOST_IDLE = 600
"""Pictures without a new view after which the collection ends."""


def pictures(config: RigConfig, camera: str, board: Board, seed: int) -> Iterator[Image]:
    """Pictures of a rig's camera as they come; a mock camera sees a board that a simulated operator moves.

    Raises:
        CameraError: the camera cannot be opened, or gives none.
    """
    if config.cameras[camera].reality is Reality.SIMULATED:
        from rig.simulator.simulated_operator import shown_boards

        yield from shown_boards(config, camera, board, seed)
        return
    opened = open_camera(config.free_running, camera)
    try:
        while True:
            yield opened.read(CAMERA_TIMEOUT_S).image
    finally:
        opened.close()


def collect(
    source: Iterable[Image],
    board: Board,
    wanted: int,
    folder: Path,
    tell: Callable[[str], None],
    enough: Callable[[], bool],
) -> list[View]:
    """Keep still views that show something new, as PNG in `folder`, until `wanted` are there that lack nothing.

    `tell` is called with each result and the next instruction; `enough` is true when the operator ends the collection.

    Raises:
        CalibrationError: the pictures ended, or brought nothing new for long, before there was a view.
    """
    kept: list[View] = []
    coverage: ViewCoverage | None = None
    before: SeenCorners | None = None
    last_line, idle = "", 0
    for picture in source:
        image = grey(picture)
        size = image.shape[1], image.shape[0]
        coverage = coverage or ViewCoverage(size)
        corners = seen_corners(board, image)
        now = None if corners is None else view_geometry(board, corners, size)
        still = (
            corners is not None and before is not None and _moved_px(corners, before) < max(1.0, _STILL_SHARE * size[0])
        )
        before = corners
        idle += 1
        if now is not None and still and coverage.is_new(now):
            coverage.add(now)
            kept.append(store(image, folder, f"view{len(kept) + 1:02}"))
            idle = 0
        advice = coverage.next_step(now)
        line = f"{len(kept)} of {wanted} views. {advice or 'any other place, distance or tilt'}"
        if line != last_line:
            tell(line)
            last_line = line
        if (len(kept) >= wanted and not advice) or enough() or idle > _MOST_IDLE:
            break
    if not kept:
        raise CalibrationError(f"no picture showed a {board.description} held still: {board.remedy}")
    return kept


def _moved_px(now: SeenCorners, before: SeenCorners) -> float:
    """Largest motion [px] of the corners that both pictures show; infinite without one."""
    here, there = now.shared(before)
    return float(np.abs(here - there).max(initial=0.0)) if len(here) else math.inf


def store(image: Image, folder: Path, stem: str) -> View:
    """Write a view as PNG and return it."""
    data = cv2.imencode(".png", image)[1].tobytes()
    file = folder / f"{stem}.png"
    with replacing(file) as part:
        part.write_bytes(data)
    return View(file.name, image, hashlib.sha256(data).hexdigest())
