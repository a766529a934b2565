"""The arm's shape at rest: Table 1 of the paper and what follows from it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Point = tuple[float, float]
LARGEST_M = 10.0
"""Larger than any soft arm; a larger value is in millimetres."""


@dataclass(frozen=True)
class Geometry:
    """Parallel tubes between two flat caps: any number of them, each anywhere in the cross-section.

    Lengths in metres. `actuator_xy_m` are the tubes' axes in the base frame: z along the straight arm, origin on the
    arm's axis. The paper's three are one case: `Geometry.paper()`.
    """

    length_m: float
    inner_radius_m: float
    outer_radius_m: float
    actuator_xy_m: tuple[Point, ...]

    def __post_init__(self) -> None:
        if any(np.shape(point) != (2,) for point in self.actuator_xy_m):
            raise ValueError(f"actuator_xy_m must be pairs of numbers, got {self.actuator_xy_m}")
        xy = tuple((float(x), float(y)) for x, y in self.actuator_xy_m)
        object.__setattr__(self, "actuator_xy_m", xy)
        sizes = (self.length_m, self.inner_radius_m, self.outer_radius_m)
        if not all(math.isfinite(c) for c in sizes + tuple(c for point in xy for c in point)):
            raise ValueError("every length of the geometry must be finite")
        if (largest := max(abs(c) for c in (*sizes, *(c for point in xy for c in point)))) > LARGEST_M:
            raise ValueError(
                f"the lengths of the geometry are in metres, expected {LARGEST_M:g} or less, got {largest:g}: "
                "is it in mm?"
            )
        if not xy:
            raise ValueError("an arm needs at least one actuator")
        if self.length_m <= 0:
            raise ValueError(f"the length must be positive, got {self.length_m} m")
        if not 0 < self.inner_radius_m < self.outer_radius_m:
            raise ValueError(
                f"radii must satisfy 0 < inner < outer, got {self.inner_radius_m} m and {self.outer_radius_m} m"
            )

    @classmethod
    def paper(cls) -> Geometry:
        """Table 1: three tubes at 120 degrees, b = 55 mm apart, R_i = 9.5 mm, R_o = 14 mm, l_o = 170 mm."""
        return cls.on_circle(0.170, 0.0095, 0.014, 0.055 / math.sqrt(3), (0.0, 120.0, 240.0))

    @classmethod
    def on_circle(
        cls,
        length_m: float,
        inner_radius_m: float,
        outer_radius_m: float,
        circle_radius_m: float,
        angles_deg: tuple[float, ...],
    ) -> Geometry:
        """Tubes on one circle, each at an angle from the base frame's x axis."""
        turns = [math.radians(angle) for angle in angles_deg]
        xy = tuple((circle_radius_m * math.cos(t), circle_radius_m * math.sin(t)) for t in turns)
        return cls(length_m, inner_radius_m, outer_radius_m, xy)

    @property
    def actuators(self) -> int:
        """How many tubes there are."""
        return len(self.actuator_xy_m)

    @cached_property
    def positions_m(self) -> NDArray[np.float64]:
        """The tubes' axes (N, 2) [m] in the base frame; read-only."""
        positions = np.array(self.actuator_xy_m, dtype=np.float64)
        positions.flags.writeable = False
        return positions

    @property
    def centroid_m(self) -> NDArray[np.float64]:
        """Centroid (2,) [m] of the walls; zero for tubes spread evenly on a circle."""
        centre: NDArray[np.float64] = self.positions_m.mean(axis=0)
        rounding = 1e-12 * float(np.abs(self.positions_m).max())
        return np.where(np.abs(centre) < rounding, 0.0, centre)

    @cached_property
    def slenderness(self) -> float:
        """Length over width, the latter twice the largest distance of a wall from the centroid."""
        away = np.linalg.norm(self.positions_m - self.centroid_m, axis=1).max() + self.outer_radius_m
        return float(self.length_m / (2 * away))

    @property
    def chamber_area_m2(self) -> float:
        """A_in = pi R_i^2, on which the pressure pushes the cap."""
        return math.pi * self.inner_radius_m**2

    @property
    def wall_area_m2(self) -> float:
        """A_m = pi (R_o^2 - R_i^2) of one tube."""
        return math.pi * (self.outer_radius_m**2 - self.inner_radius_m**2)

    @property
    def wall_second_moment_m4(self) -> float:
        """I_o = pi (R_o^4 - R_i^4) / 4 of one tube about its own axis."""
        return math.pi * (self.outer_radius_m**4 - self.inner_radius_m**4) / 4
