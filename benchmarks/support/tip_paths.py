"""Sharp and growing tip paths along straight lines, and the controllers that follow them beside each other."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import protocols
from benchmarks.support.virtual_tip_run import SHARED_HORIZON
from model.arrays import Array
from protocols import SetPointTrajectory
from rig.tip_planning.inverse import RigTipInverse

Row = dict[str, Any]

HEIGHT_MM = 190.0
CONTROLLERS = {
    "horizon": SHARED_HORIZON,
    "inverse-integral": "inverse-integral",
    "static-inverse": "static-inverse",
    "feed-forward": "feed-forward",
}


def letter() -> Array:
    """Corners (n, 2) [mm] of a letter S, 12 straight lines."""
    x = [14, 8, 0, -10, -14, -8, 8, 14, 10, 0, -8, -14]
    y = [16, 21, 22, 18, 10, 3, -3, -10, -18, -22, -21, -16]
    return np.array([x, y], dtype=np.float64).T


def spiral() -> Array:
    """Corners of a spiral of four turns that grows to a radius of 25 mm."""
    turns = np.linspace(0.0, 4.0, 97)
    radius = 25 * turns / 4
    return np.stack([radius * np.cos(2 * np.pi * turns), radius * np.sin(2 * np.pi * turns)], axis=1)


def square() -> Array:
    """Corners of a square of 30 mm, three times."""
    once = 15.0 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    return np.vstack([once, once, once, once[:1]])


PATHS: dict[str, Callable[[], Array]] = {"S": letter, "spiral": spiral, "square": square}


def planned(corners_mm: Array, speed_mm_s: float, inverse: RigTipInverse) -> SetPointTrajectory:
    """The trajectory along straight lines at one speed, from rest and back to rest."""
    times = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners_mm, axis=0), axis=1)) / speed_mm_s])
    rows = np.column_stack([times, corners_mm, np.full(len(times), HEIGHT_MM)])
    with tempfile.TemporaryDirectory() as name:
        lines = ["time_s,x_mm,y_mm,z_mm", *(",".join(f"{value:.4f}" for value in row) for row in rows)]
        (Path(name) / "path.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
        steps: list[Row] = [{"hold": {"duration_s": 0.1}}, {"tip": {"csv": {"file": "path.csv"}, "lead_in_s": 2.0}}]
        return protocols.from_steps("path", steps, Path(name)).expand(3, inverse)
