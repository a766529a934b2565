"""The families of square markers that boards may carry, by the names that OpenCV gives them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, get_args

MarkerFamily = Literal[
    "4X4_50",
    "4X4_100",
    "4X4_250",
    "4X4_1000",
    "5X5_50",
    "5X5_100",
    "5X5_250",
    "5X5_1000",
    "6X6_50",
    "6X6_100",
    "6X6_250",
    "6X6_1000",
    "7X7_50",
    "7X7_100",
    "7X7_250",
    "7X7_1000",
    "APRILTAG_16h5",
    "APRILTAG_25h9",
    "APRILTAG_36h10",
    "APRILTAG_36h11",
]

_APRILTAGS = {"APRILTAG_16h5": 30, "APRILTAG_25h9": 35, "APRILTAG_36h10": 2320, "APRILTAG_36h11": 587}
MARKERS: Mapping[str, int] = {
    name: _APRILTAGS[name] if name in _APRILTAGS else int(name.split("_")[1]) for name in get_args(MarkerFamily)
}
"""How many markers each family has."""
