"""Values that no arm has are refused with their line; what passes the check runs or ends with a sentence."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from model import Arm, Material
from model.statics import statics
from protocols import BadInputError
from rig.config import loader
from rig.hardware.cards.base import CardError
from rig.simulator.plant import Plant

MOCK = loader.text("mock")


@pytest.mark.parametrize(
    ("old", "new", "where", "expected"),
    [
        ("cap_mass_g: 52", "cap_mass_g: 52000", "simulator, cap_mass_g", "0 to 5000 (g)"),
        ("square_mm: 8", "square_mm: 1.0e-308", "board, square_mm", "0.01 to 10000 (mm)"),
        ("a1_per_N: 0.00765", "a1_per_N: 1.0e-308", "simulator, material, a1_per_N", "1e-06 to 10"),
        ("youngs_modulus_pa: 289142.05", "youngs_modulus_pa: 0.289", "youngs_modulus_pa", "1000 to 1"),
        ("length_mm: 170", "length_mm: 170000", "length_mm", "0.01 to 10000 (mm)"),
        ("pressure_bar: 0.7", "pressure_bar: 70", "limits, pressure_bar", "up to 10 (bar)"),
        ("rate_bar_per_s: 1.0", "rate_bar_per_s: 1.0e+6", "limits, rate_bar_per_s", "up to 100 (bar/s)"),
        ("limits:", "limits:\n  rate_margin_bar_per_s: 5000", "limits, rate_margin_bar_per_s", "0 to 1000 (bar/s)"),
        ("tracking_bar: 0.05", "tracking_bar: 50", "limits, tracking_bar", "up to 10 (bar)"),
        ("tracking_s: 1.0", "tracking_s: 1000", "limits, tracking_s", "up to 60 (s)"),
        ("frozen_s: 0.5", "frozen_s: 500", "limits, frozen_s", "up to 60 (s)"),
        ("stale_s: 0.1", "stale_s: 100", "limits, stale_s", "up to 60 (s)"),
        ("no_tip_s: 1.0", "no_tip_s: 1000", "limits, no_tip_s", "up to 60 (s)"),
        ("limits:", "limits:\n  hung_s: 100", "limits, hung_s", "up to 60 (s)"),
        ("integral_s: 0.2", "integral_s: 200", "control, integral_s", "up to 100 (s)"),
        ("volume_ml: 60", "volume_ml: 60000", "control, volume_ml", "up to 10000 (ml)"),
        ("full_flow_l_min: 100", "full_flow_l_min: 1.0e+6", "full_flow_l_min", "up to 100000"),
        ("cx_px: 320", "cx_px: 100", "lens, cx_px", "160 to 480 px"),
        ("cy_px: 240", "cy_px: 470", "lens, cy_px", "120 to 360 px"),
        ("fx_px: 620", "fx_px: 4.2", "lens, fx_px", "64 to 32000 px"),
        ("dead_zone_V: 0.45", "dead_zone_V: 450", "simulator, valve, dead_zone_V", "less than 5 V"),
        ("leakage_l_min: 1.5", "leakage_l_min: 150", "simulator, valve, leakage_l_min", "less than full_flow_l_min"),
        ("spool_hz: 115", "spool_hz: 115000", "simulator, valve, spool_hz", "0.1 to 1000"),
        ("flow_scale: 1.05", "flow_scale: 105", "simulator, valve, flow_scale", "0.1 to 10"),
        ("flow_scale: 1.05", "hysteresis_percent: 40", "simulator, valve, hysteresis_percent", "0 to 20"),
        ("flow_scale: 1.05", "spool_damping: 700", "simulator, valve, spool_damping", "0.01 to 100"),
        ("dead_volume_ml: 15", "dead_volume_ml: 1.0e+200", "simulator, chamber, dead_volume_ml", "0 to 10000"),
        ("dead_volume_ml: 15", "dead_volume_ml: 15, temperature_k: 20", "chamber, temperature_k", "200 to 400"),
        ("noise_bar: 0.001", "noise_bar: 1000", "simulator, sensor, noise_bar", "at most the sensors' span_bar"),
        ("offset_bar: 0.002", "offset_bar: 100000", "simulator, sensor, offset_bar", "at most the sensors' span_bar"),
        ("lag_ms: 3", "lag_ms: 100000", "simulator, sensor, lag_ms", "0 to 10000"),
        ("blur_px: 0.6", "blur_px: 6000", "simulator, scene, blur_px", "0 to 50"),
        ("noise_grey: 2.0", "noise_grey: 2000", "simulator, scene, noise_grey", "0 to 255"),
        ("noise_grey: 2.0", "noise_grey: 2.0, skew_ms: 500", "simulator, scene, skew_ms", "at most 33.33 ms"),
        ("translation_mm: [0, 400, 200]", "translation_mm: [0, 1.0e+300, 200]", "placement, translation_mm", "100000"),
        ("rotation_deg: [90, 0, 0]", "rotation_deg: [1.0e+300, 0, 0]", "placement, rotation_deg", "3600"),
    ],
)
def test_a_value_that_no_arm_has_is_refused_with_its_line_and_range(
    old: str, new: str, where: str, expected: str
) -> None:
    assert old in MOCK
    text = MOCK.replace(old, new, 1)
    with pytest.raises(BadInputError) as refused:
        loader.parse(text, "rig.yaml")
    problem = refused.value.problems[0]
    assert where in problem.where
    assert expected in problem.expected
    assert new.split(": ")[1] in text.splitlines()[problem.line - 1]
    assert problem.column > 1


def test_the_true_geometry_is_checked_like_the_stated_one() -> None:
    geometry = yaml.safe_load(MOCK)["arm"]["geometry"]
    rig = yaml.safe_load(MOCK)
    rig["simulator"]["geometry"] = {**geometry, "inner_radius_mm": 20, "actuator_angles_deg": [0, 120]}
    rig["simulator"]["camera_errors"] = {"frnt": {"translation_mm": [1, 0, 0]}}
    with pytest.raises(BadInputError) as refused:
        loader.parse(yaml.safe_dump(rig), "rig.yaml")
    found = {problem.where: problem.expected for problem in refused.value.problems}
    assert "less than outer_radius_mm" in found["simulator, geometry, inner_radius_mm"]
    assert found["simulator, geometry, actuator_angles_deg"].startswith("3 angles")
    assert found["simulator, camera_errors, frnt"] == "one of the cameras: front"


@pytest.mark.slow
def test_a_simulated_arm_without_equilibrium_is_refused_in_one_sentence() -> None:
    text = MOCK.replace("cap_mass_g: 52", "cap_mass_g: 5000").replace("a1_per_N: 0.00765", "a1_per_N: 5")
    with pytest.raises(CardError, match="cannot carry its own weight"):
        Plant(loader.parse(text, "rig.yaml"), 0, 0)


@pytest.mark.parametrize(
    ("pressure", "said"),
    [
        ([0.65, 0.0, 0.0], "look like bar"),
        (np.array([0.65, 0.3, 0.3]), "look like bar"),
        ([-2e5, 0.0, 0.0], "below vacuum"),
        ([6.5e9, 0.0, 0.0], "converted twice"),
    ],
)
def test_pressures_in_another_unit_are_refused(pressure: list[float], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        statics(Arm.paper(), pressure)
    if said != "converted twice":
        assert statics(Arm.paper(), pressure, doubt_units=False).ok


@pytest.mark.parametrize("pressure", [[0, 0, 0], [65000.0, 0, 0], [0.0, 0.123456, 3.2], [15.26, 0, 0], [-3.0, 0, 0]])
def test_pressures_in_pascal_are_taken_however_small(pressure: list[float]) -> None:
    assert statics(Arm.paper(), pressure).ok


def test_a_modulus_in_another_unit_is_refused() -> None:
    with pytest.raises(ValueError, match="kPa or MPa"):
        Material(0.289, 0.0074, 0.0003, 0.05, 0.41)


def _numbers(node: object, path: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    """Paths of every number of a part of a YAML."""
    if isinstance(node, dict):
        return [found for key, child in node.items() for found in _numbers(child, (*path, key))]
    if isinstance(node, list):
        return [found for i, child in enumerate(node) for found in _numbers(child, (*path, i))]
    return [path] if isinstance(node, int | float) and not isinstance(node, bool) else []


RIG = yaml.safe_load(MOCK)
PLACES = [path for part in ("simulator", "arm", "valves", "control", "limits") for path in _numbers(RIG[part], (part,))]


@pytest.mark.slow
@settings(max_examples=40, suppress_health_check=list(HealthCheck), deadline=None)
@given(
    st.lists(st.tuples(st.sampled_from(PLACES), st.sampled_from((0, 1e-6, 1e-3, 0.1, 10, 1e3, 1e6, -1))), max_size=3),
    st.floats(0.0, 10.0),
)
def test_a_checked_rig_runs_or_ends_with_one_sentence(
    changes: list[tuple[tuple[str | int, ...], float]], volts: float
) -> None:
    changed = yaml.safe_load(MOCK)
    for path, factor in changes:
        node = changed
        for key in path[:-1]:
            node = node[key]
        node[path[-1]] = float(f"{node[path[-1]] * factor:.6g}") if factor % 1 else node[path[-1]] * int(factor)
    try:
        config = loader.parse(yaml.safe_dump(changed), "rig.yaml")
    except BadInputError:
        return
    with suppress(CardError):
        plant = Plant(config, 0, 0)
        plant.card("daq").write(np.full(len(config.valves), volts))
        plant.advance(60_000_000)
