"""What the tip can reach at rest within the limits of the pressures."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.optimize import least_squares

from model import batch, sensitivities
from model.arm import Arm
from model.arrays import Array
from model.inverse.drive import Drive
from model.units import MM_PER_M, PA_PER_BAR
from model.variation import GRADIENT_STEP_PA, Variation

STARTS = (0.1, 0.5, 0.9)
"""Pressures of each valve among which the search starts, relative to the highest pressure."""
SEARCHES = 4
"""Starting points of the search: those whose tips are the nearest to the target."""


@dataclass(frozen=True, eq=False)
class ReachablePoint:
    """The tip (3,) [m] nearest to a target, its distance [m], and the pressures (V,) [Pa] of the valves."""

    tip_m: Array
    distance_m: float
    pressure_pa: Array


def nearest_reachable(
    arm: Arm, drive: Drive, target_m: Array, coordinates: tuple[int, ...] = (0, 1, 2), weight_kg: float = 0.0
) -> ReachablePoint:
    """The point nearest to target_m (3,) in some coordinates that the tip reaches at rest.

    Bounded least squares (dogleg in a box) with the model's gradients, from the nearest points of a coarse grid.
    """
    axes, matrix = list(coordinates), drive.matrix()
    solved: dict[bytes, sensitivities.Gradients] = {}

    def at(pressure_bar: Array) -> sensitivities.Gradients:
        rows = (pressure_bar * PA_PER_BAR) @ matrix.T
        changes = [Variation(GRADIENT_STEP_PA, arm, rows + GRADIENT_STEP_PA * column) for column in matrix.T]
        weights = np.full(len(rows), weight_kg) if weight_kg else None
        return sensitivities.statics(arm, rows, changes, weights, workers=1)

    def gradients(pressure_bar: Array) -> sensitivities.Gradients:
        key = pressure_bar.tobytes()
        if key not in solved:
            solved.clear()
            solved[key] = at(pressure_bar[None])
        return solved[key]

    def error_mm(pressure_bar: Array) -> Array:
        return np.asarray((gradients(pressure_bar).tip_m[0, axes] - target_m[axes]) * MM_PER_M)

    def gradient(pressure_bar: Array) -> Array:
        return gradients(pressure_bar).tip_by[0, axes] * MM_PER_M * PA_PER_BAR

    highest = drive.highest_pa / PA_PER_BAR
    grid = highest * np.array(list(product(STARTS, repeat=drive.valves)))
    coarse = at(grid)
    distance_m = np.linalg.norm(coarse.tip_m[:, axes] - target_m[axes], axis=1)
    nearest = [k for k in np.argsort(distance_m, kind="stable") if coarse.ok[k]][:SEARCHES]
    best: tuple[float, Array] | None = None
    for start in grid[nearest]:
        try:
            found = least_squares(
                error_mm, start, gradient, bounds=(0.0, highest), method="dogbox", xtol=1e-12, ftol=1e-12, gtol=1e-12
            )
        except ValueError:  # no equilibrium on the way
            continue
        if best is None or found.cost < best[0]:
            best = float(found.cost), found.x
    if best is None:
        raise ArithmeticError("the arm has no stable equilibrium within the limits of its pressures")
    pressure = np.clip(best[1], 0.0, highest)
    tip = gradients(pressure).tip_m[0].copy()
    distance = float(np.linalg.norm(tip[axes] - target_m[axes]))
    return ReachablePoint(tip, distance, pressure * PA_PER_BAR)


def reachable_tips(arm: Arm, drive: Drive, levels: int) -> tuple[Array, Array]:
    """Pressures (levels^V, V) [Pa] on a grid, and the tips (levels^V, 3) [m] at rest; NaN without an equilibrium."""
    axis = np.linspace(0.0, drive.highest_pa, levels)
    pressure = np.array(list(product(axis, repeat=drive.valves)))
    return pressure, batch.statics(arm, pressure @ drive.matrix().T).tip_m
