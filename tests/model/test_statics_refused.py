"""Pressures, loads, arms and step counts that statics refuses."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from model import Arm, Geometry, Loads, Material
from model.statics import statics

BAR = 1e5


@pytest.mark.parametrize("wrong", [(0, 0), (0, 0, 0, 0), (0, math.nan, 0), (math.inf, 0, 0), [[0, 0, 0]]])
def test_pressures_of_the_wrong_kind_are_refused(wrong: object) -> None:
    with pytest.raises(ValueError, match=r"pressure"):
        statics(Arm.paper(), wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "wrong",
    [
        {"tip_force_n": (0, 0)},
        {"tip_moment_n_m": (0, 0, math.nan)},
        {"force_n_per_m": np.zeros((4, 2))},
        {"tip_point_m": np.zeros((2, 3))},
    ],
)
def test_loads_of_the_wrong_kind_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        statics(Arm.paper(), (0, 0, 0), Loads(**wrong))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "change",
    [
        {"length_m": 0.0},
        {"inner_radius_m": 0.02},
        {"inner_radius_m": -0.001},
        {"actuator_xy_m": ()},
        {"length_m": math.nan},
        {"actuator_xy_m": (0.01, 0.02)},
    ],
)
def test_an_invalid_geometry_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"length|radii|actuator"):
        replace(Geometry.paper(), **change)


@pytest.mark.parametrize(
    "change",
    [
        {"youngs_modulus_pa": 0.0},
        {"a1_per_n": -1.0},
        {"a2_per_n2": -1e-9},
        {"damping_s": -1.0},
        {"shear_ratio": math.nan},
    ],
)
def test_an_invalid_material_is_refused(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(change))):
        replace(Material.paper(), **change)


@pytest.mark.parametrize(
    "change", [{"cap_mass_kg": -0.1}, {"cap_inertia_kg_m2": (0, -1e-6, 0)}, {"gravity_m_s2": (0, 9.81)}]
)
def test_an_invalid_arm_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"mass|cap_inertia_kg_m2|gravity_m_s2"):
        replace(Arm.paper(), **change)  # type: ignore[arg-type]


def test_unknown_variants_are_refused_with_the_known_ones_named() -> None:
    with pytest.raises(ValueError, match=r"inhomogeneous\+rpe"):
        Arm.paper("heterogeneous")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "change",
    [
        {"length_m": 170.0},
        {"outer_radius_m": 14.0},
        {"outer_radius_m": 1e308},
        {"actuator_xy_m": ((31.75, 0.0), (-15.9, 27.5), (-15.9, -27.5))},
    ],
)
def test_a_geometry_in_millimetres_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"in metres, expected 10 or less, got .*: is it in mm\?"):
        replace(Geometry.paper(), **change)  # type: ignore[arg-type]


@pytest.mark.parametrize("nodes", [20_001, 2**62])
def test_more_steps_than_fit_memory_and_time_are_refused(nodes: int) -> None:
    with pytest.raises(ValueError, match=f"at most 20000 steps along it, got {nodes}"):
        statics(Arm.paper(), (1e4, 0, 0), nodes=nodes)


def test_an_arm_so_slender_that_it_needs_more_steps_is_refused() -> None:
    thin = Geometry.on_circle(10.0, 1e-5, 2e-5, 3e-5, (0.0, 120.0, 240.0))
    with pytest.raises(ValueError, match="at most 20000 steps along it"):
        statics(Arm.paper().with_segment(geometry=thin), (0, 0, 0))
