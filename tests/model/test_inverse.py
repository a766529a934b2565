"""Pressures for tips: inverse statics and dynamics, limits, and what can be reached."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from model import Arm, Loads, batch, statics
from model.arrays import Array
from model.dynamics import Dynamics
from model.inverse import path as path_module
from model.inverse.drive import Drive
from model.inverse.limited_step import limited_step
from model.inverse.path import PathFollowing, PathInverse
from model.inverse.reachable import nearest_reachable, reachable_tips

PAPER = Arm.paper()
ARM = PAPER.with_segment(material=replace(PAPER.material, damping_s=0.01))
THREE = Drive(((0,), (1,), (2,)), 0.7e5, 1e5)
TWO = Drive(((0,), (1, 2)), 0.7e5, 1e5)
DT_S = 0.01


def circle(radius_m: float, hz: float, seconds: float, height_m: float = 0.19) -> Array:
    """A circle that grows from its centre in the first half of the time."""
    t = np.arange(0, seconds + 1e-9, DT_S)
    size = radius_m * np.clip(2 * t / seconds, 0, 1) ** 2 * (3 - 2 * np.clip(2 * t / seconds, 0, 1))
    turn = 2 * np.pi * hz * t
    return np.column_stack([size * np.cos(turn), size * np.sin(turn), np.full(len(t), height_m)])


def at_height(height_m: float) -> Array:
    """Pressures (3,) under which the tip stands at rest above the base."""
    found = nearest_reachable(ARM, THREE, np.array([0, 0, height_m]))
    assert found.distance_m < 1e-7
    return found.pressure_pa


def followed(target: Array, drive: Drive = THREE, loads: Loads | None = None, weight_kg: float = 0.0) -> PathFollowing:
    before = np.tile(at_height(0.19), (11, 1))
    return PathInverse(ARM, drive, DT_S, loads, weight_kg).follow(target, (0, 1, 2), before)


@pytest.mark.parametrize(("hz", "most_mm"), [(0.5, 0.01), (1.0, 0.03)])
def test_the_tip_of_a_finer_simulation_follows_the_path(hz: float, most_mm: float) -> None:
    target = circle(0.02, hz, 4.0)
    found = followed(target)
    fine = DT_S / 5
    times = np.arange(0, 4.0 + 1e-9, fine)
    grid = np.arange(len(target)) * DT_S
    pressure = np.column_stack([np.interp(times, grid, column) for column in found.pressure_pa.T])
    dynamics = Dynamics(ARM, fine)
    dynamics.start(pressure[0])
    tips = dynamics.run(pressure[1:]).tip_m
    error_mm = np.linalg.norm(tips[4::5] - target[1:], axis=1) * 1e3
    assert error_mm.max() < most_mm


def test_the_tip_of_a_fast_path_is_far_off_under_static_pressures() -> None:
    # What the dynamic solution is for: under pressures of the statics the tip is off by more than a millimetre.
    target = circle(0.02, 1.0, 2.0)
    inverse = PathInverse(ARM, THREE, DT_S)
    start = at_height(0.19)
    pressure, _ = inverse._static(target, [0, 1, 2], start, start)
    dynamics = Dynamics(ARM, DT_S)
    dynamics.start(pressure[0])
    error_mm = np.linalg.norm(dynamics.run(pressure[1:]).tip_m - target[1:], axis=1) * 1e3
    assert error_mm[100:].max() > 1.0


def test_a_weight_on_the_tip_is_taken_into_account() -> None:
    hung = Loads(tip_force_n=(0, 0, 0.05 * 9.81))
    target = circle(0.01, 0.5, 2.0, 0.192)
    found = followed(target, loads=hung, weight_kg=0.05)
    dynamics = Dynamics(ARM, DT_S)
    dynamics.start(found.pressure_pa[0], hung)
    last = [dynamics.step(row, hung).tip_m for row in found.pressure_pa[1:]][-1]
    assert np.linalg.norm(last - target[-1]) < 5e-5


def test_limits_hold_on_a_path_that_asks_for_more() -> None:
    target = circle(0.05, 1.5, 2.0)
    pressure = followed(target).pressure_pa
    assert pressure.min() >= 0
    assert pressure.max() <= THREE.highest_pa
    assert np.abs(np.diff(pressure, axis=0)).max() <= THREE.rate_pa_s * DT_S * (1 + 1e-6)


@pytest.mark.parametrize("radius_m", [0.02, 0.045])
def test_a_path_in_windows_has_the_pressures_of_the_path_as_a_whole(
    monkeypatch: pytest.MonkeyPatch, radius_m: float
) -> None:
    # The large circle is beyond the rate limit: pressures have to move before they are needed.
    target = circle(radius_m, 0.7, 9.0)
    whole, rows = followed(target), []

    def counted(gradient: Array, shift_m: Array, pressure_pa: Array, drive: Drive, dt_s: float) -> Array:
        rows.append(len(pressure_pa))
        return limited_step(gradient, shift_m, pressure_pa, drive, dt_s)

    monkeypatch.setattr(path_module, "limited_step", counted)
    monkeypatch.setattr(path_module, "WINDOW_S", 2.0)
    parts = followed(target)
    assert max(rows) <= round((2.0 + path_module.AHEAD_S + THREE.highest_pa / THREE.rate_pa_s) / DT_S) + 1
    assert np.abs(parts.pressure_pa - whole.pressure_pa).max() < 100
    assert parts.error_m(target, (0, 1, 2)).max() < whole.error_m(target, (0, 1, 2)).max() + 1e-5
    motion = Dynamics(ARM, DT_S)
    motion.start(parts.pressure_pa[0])
    assert np.abs(motion.run(parts.pressure_pa[1:]).tip_m - parts.tip_m[1:]).max() < 1e-9


def test_pressures_that_a_path_leaves_open_do_not_drift_from_window_to_window(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(path_module, "WINDOW_S", 0.5)
    start = np.full(3, 0.1e5)
    tip = np.array(statics.statics(ARM, start).tip_m)
    target = np.tile(tip, (1000, 1)) + 0.01 * np.sin(np.pi * DT_S * np.arange(1000.0))[:, None] ** 2 * [1, 0, 0]
    found = PathInverse(ARM, THREE, DT_S).follow(target, (0, 1), np.tile(start, (11, 1)))
    mean = found.pressure_pa.mean(axis=1)
    assert mean[200:].max() - mean[200:].min() < 0.01e5


def test_two_valves_control_two_coordinates() -> None:
    # Two valves start where their arm can be: equal pressures in the actuators of a valve.
    pressure = np.full(3, 0.3e5)
    start = np.array(statics.statics(ARM, pressure).tip_m)
    t = np.arange(0, 2, DT_S)[:, None]
    target = start + np.sin(np.pi * t) ** 2 * np.array([0.004, 0.0, 0.002])
    found = PathInverse(ARM, TWO, DT_S).follow(target, (0, 2), np.tile(pressure, (11, 1)))
    assert found.pressure_pa.shape == (len(t), 2)
    assert found.error_m(target, (0, 2)).max() < 2e-5


def test_a_step_within_limits_solves_the_normal_equations_and_a_limited_one_is_optimal() -> None:
    rng = np.random.default_rng(3)
    gradient = 1e-6 * (np.eye(3) + 0.2 * rng.standard_normal((40, 3, 3)))
    now = np.full((40, 3), 3e4)
    slack = Drive(((0,), (1,), (2,)), 1e6, 1e12)
    shift = 1e-4 * rng.standard_normal((40, 3))
    shift[0] = 0
    free = limited_step(gradient, shift, now, slack, DT_S)
    assert np.einsum("nij,nj->ni", gradient, free - now) == pytest.approx(shift, abs=2e-7)
    tight = Drive(((0,), (1,), (2,)), 3.005e4, 1e5)
    found = limited_step(gradient, 100 * shift, now, tight, DT_S)

    def cost(pressure: Array) -> float:
        return float(((np.einsum("nij,nj->ni", gradient, pressure - now) - 100 * shift) ** 2).sum())

    for _ in range(200):
        # Any other admissible trajectory nearby costs more.
        other = now + 0.98 * (found - now) + 0.02 * (rng.uniform(-1, 1, 3) * 50)
        other[0] = now[0]
        if np.abs(np.diff(other, axis=0)).max() <= 1e3 and other.max() <= 3.005e4:
            assert cost(other) >= cost(found) * (1 - 1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    "target_mm",
    [(60, 0, 160), (0, 0, 240), (-45, 30, 205), (5, -5, 150), (30, 80, 190), (20, 10, 185)],
)
def test_the_nearest_reachable_point_is_that_of_a_dense_search(target_mm: tuple[float, float, float]) -> None:
    target = np.array(target_mm) * 1e-3
    found = nearest_reachable(ARM, THREE, target)
    levels = 15
    pressure, tips = reachable_tips(ARM, THREE, levels)
    best = pressure[np.nanargmin(np.linalg.norm(tips - target, axis=1))]
    width = THREE.highest_pa / (levels - 1)
    # Refine the grid around its best point until its cells are far below 0.1 mm.
    for _ in range(12):
        axes = [np.clip(p + width * np.linspace(-1, 1, 5), 0, THREE.highest_pa) for p in best]
        grid = np.array(np.meshgrid(*axes)).reshape(3, -1).T
        distances = np.linalg.norm(batch.statics(ARM, grid).tip_m - target, axis=1)
        best, dense = grid[np.argmin(distances)], float(distances.min())
        width *= 0.5
    assert found.distance_m == pytest.approx(dense, abs=1e-5)
    assert found.distance_m <= dense + 1e-7
    assert np.linalg.norm(np.array(statics.statics(ARM, found.pressure_pa).tip_m) - found.tip_m) < 1e-8


def test_the_nearest_reachable_point_is_that_of_another_optimiser() -> None:
    # A quasi-Newton method with numerical derivatives of the rod, from the best points of a grid.
    levels, steps_bar = 9, np.vstack([np.zeros(3), 1e-4 * np.eye(3), -1e-4 * np.eye(3)])
    grid, reached = reachable_tips(ARM, THREE, levels)
    rng = np.random.default_rng(7)
    for target in np.column_stack([rng.uniform(-0.1, 0.1, (6, 2)), rng.uniform(0.12, 0.26, 6)]):

        def cost(pressure_bar: Array, target: Array = target) -> tuple[float, Array]:
            gap_mm = 1e3 * (batch.statics(ARM, 1e5 * np.maximum(pressure_bar + steps_bar, 0)).tip_m - target)
            square = (gap_mm**2).sum(axis=1)
            return float(square[0]), (square[1:4] - square[4:]) / 2e-4

        distances = np.linalg.norm(reached - target, axis=1)
        searches = [
            minimize(cost, grid[start] / 1e5, jac=True, method="L-BFGS-B", bounds=[(0, 0.7)] * 3)
            for start in np.argsort(distances)[:9:4]
        ]
        best = min(searches, key=lambda search: float(search.fun))
        found = nearest_reachable(ARM, THREE, target)
        assert found.distance_m <= 1e-3 * np.sqrt(best.fun) + 1e-6
        assert np.linalg.norm(found.tip_m - statics.statics(ARM, 1e5 * best.x).tip_m) < 1e-4
