"""What a picture of each kind of board costs, against a checkerboard's in the same run: docs/validation/vision.md.

    python -m benchmarks.board_pace [--pictures 150] [--seed 0]

Every kind moves in the same way before one camera of 1280x960 pixels, and the kinds take turns picture by picture, so
that what else the machine does falls on all of them. CPU time, medians: drawing by the mock camera, following, and
finding the board anew in a whole picture.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from typing import TypeVar

import cv2
import numpy as np

from benchmarks.boards import BOARDS, FACING, LENS, ours
from calibration.vision.board import Board
from calibration.vision.checkerboard import Checkerboard
from calibration.vision.tracker import BoardTracker
from calibration.vision.transforms import RigidTransform

Result = TypeVar("Result")
_TILT_RAD = np.deg2rad(30)
_UNCOUNTED = 5
KINDS: dict[str, Board] = {"checkerboard 6x5": Checkerboard(6, 5, 0.010)} | BOARDS


def place(k: int) -> RigidTransform:
    """The board in the camera at picture `k`, 0.4 m away: 60 mm to and fro in two seconds."""
    back = RigidTransform.from_vectors((_TILT_RAD, 0.0, 0.02 * k), (0.0, 0.0, 0.0)).rotation
    return RigidTransform(FACING @ back, np.array([0.03 * np.sin(np.pi * k / 30), 0.0, 0.4]))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--pictures", type=int, default=150)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    cv2.setNumThreads(1)
    draws = {name: ours(board, None, asked.seed) for name, board in KINDS.items()}
    trackers = {name: BoardTracker(board, LENS) for name, board in KINDS.items()}
    ms: dict[str, list[tuple[float, float, float]]] = {name: [] for name in KINDS}
    for k in range(asked.pictures):
        for name, board in KINDS.items():
            picture, drawing = _timed(partial(draws[name], place(k), k))
            _, following = _timed(partial(trackers[name].detect, picture))
            _, finding = _timed(partial(board.find, picture))
            ms[name].append((drawing, following, finding))
    print("| board | drawing [ms] | following [ms] | finding [ms] | ratio of the first two to the checkerboard's |")
    print("|---|---|---|---|---|")
    medians = {name: np.median(times[_UNCOUNTED:], axis=0) for name, times in ms.items()}
    first = next(iter(medians.values()))
    for name, found in medians.items():
        cells = " | ".join(f"{value:.2f}" for value in found)
        print(f"| {name} | {cells} | {found[0] / first[0]:.1f} / {found[1] / first[1]:.1f} |")


def _timed(work: Callable[[], Result]) -> tuple[Result, float]:
    """What it gives, and its CPU time [ms]."""
    began = time.thread_time()
    return work(), (time.thread_time() - began) * 1e3


if __name__ == "__main__":
    main()
