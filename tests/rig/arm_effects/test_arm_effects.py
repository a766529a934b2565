"""Effects of the simulated arm: closed forms, energy, rate independence, and what the rig file may say."""

from __future__ import annotations

import itertools
import math
import re

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from model.arrays import Array
from model.statics import statics
from protocols import BadInputError
from rig.arm_effects.base import ArmEffect
from rig.arm_effects.effects import CreepSection, HysteresisSection, SofteningSection
from rig.arm_effects.registry import ARM_EFFECTS
from rig.config import loader
from rig.config.arm_model import true_arm
from rig.config.simulator_sections import Simulator
from rig.simulator.plant import ARM_STEP_S, Plant
from tests.support.plant_bench import mock_rig

CREEP = {"type": "creep", "branches": [{"amount": 0.03, "time_s": 1.0}, {"amount": 0.02, "time_s": 20.0}]}
HYSTERESIS = {
    "type": "hysteresis",
    "elements": [{"weight": 0.05, "slip_bar": 0.02}, {"weight": 0.04, "slip_bar": 0.1}],
}
SOFTENING = {"type": "softening", "by_peak": 0.04, "peak_bar": 0.3, "by_cycles": 0.02, "travel_bar": 2.0}
GAINS = {"type": "gains", "gains": [1.0, 1.03, 0.97]}
COUPLING = {"type": "coupling", "share": 0.05}
PUSH = {"type": "push", "per_bar": 0.15}
PUSH_SUM = {"type": "push", "per_bar": 0.15, "pressure": "sum"}
STILL = {"simulator__valve__leakage_l_min": 0.0, "simulator__valve__hysteresis_percent": 0.0}
EVERY = [COUPLING, CREEP, GAINS, HYSTERESIS, PUSH, PUSH_SUM, SOFTENING]

paths = st.lists(st.floats(0.0, 0.7), min_size=2, max_size=6)


def played(effect: ArmEffect, pressure_bar: Array) -> Array:
    return np.array([effect(row.tolist()) for row in np.atleast_2d(pressure_bar)])


def hysteresis(actuators: int = 1) -> ArmEffect:
    return HysteresisSection.model_validate(HYSTERESIS).effect(actuators, ARM_STEP_S)


def along(corners: list[float], points: int) -> Array:
    """Straight stretches between the corners, so many points on each, from and back to zero."""
    ends = [0.0, *corners, 0.0]
    stretches = [np.linspace(a, b, points + 1)[1:] for a, b in itertools.pairwise(ends)]
    return np.concatenate(stretches)[:, None]


def test_a_step_creeps_as_the_sum_of_exponentials() -> None:
    effect = CreepSection.model_validate(CREEP).effect(1, ARM_STEP_S)
    push = played(effect, np.full((20_000, 1), 0.5))[:, 0]
    t = ARM_STEP_S * np.arange(1, 20_001)
    expected = 0.5 * (1 + 0.03 * (1 - np.exp(-t / 1.0)) + 0.02 * (1 - np.exp(-t / 20.0)))
    np.testing.assert_allclose(push, expected, rtol=1e-12)


def test_creep_recovers_after_the_pressure_is_gone() -> None:
    effect = CreepSection.model_validate(CREEP).effect(1, 1.0)
    push = played(effect, np.array([[0.5]] * 200 + [[0.0]] * 50))[:, 0]
    charge = 1 - math.exp(-200 / 20)
    assert push[249] == pytest.approx(0.5 * 0.02 * charge * math.exp(-50 / 20), rel=1e-9)


def test_hysteresis_starts_stiff_and_slips_at_its_thresholds() -> None:
    push = played(hysteresis(), np.linspace(0, 0.3, 301)[:, None])[:, 0]
    p = np.linspace(0, 0.3, 301)
    np.testing.assert_allclose(push, p - 0.05 * np.minimum(p, 0.02) - 0.04 * np.minimum(p, 0.1), atol=1e-15)


@given(paths, st.integers(1, 7))
def test_hysteresis_does_not_depend_on_the_rate(corners: list[float], points: int) -> None:
    slow, fast = played(hysteresis(), along(corners, points)), played(hysteresis(), along(corners, 1))
    np.testing.assert_allclose(slow[points - 1 :: points], fast, atol=1e-14)


@pytest.mark.slow
@given(paths)
def test_the_energy_that_a_loop_dissipates_is_its_area_and_never_negative(corners: list[float]) -> None:
    """On a closed loop of pressure and elements: slipping at r_k dissipates w_k r_k |d play|."""
    path = np.concatenate([along([0.7], 1), along(corners, 200), along([0.7], 200)])
    effect, p = hysteresis(), path[:, 0]
    push = played(effect, path)[:, 0]
    play = np.zeros(2)
    slip, weight = np.array([0.02, 0.1]), np.array([0.05, 0.04])
    dissipated = np.zeros(len(p))
    for i, pressure in enumerate(p):
        moved = np.clip(play, pressure - slip, pressure + slip)
        dissipated[i] = (weight * slip * np.abs(moved - play)).sum()
        play = moved
    # After the first return from 0.7 bar (sample 1) every slider stands at its limit; it does so again at the end.
    area = (0.5 * (p[2:] + p[1:-1]) * np.diff(push[1:])).sum()
    assert area > 0.0
    assert area == pytest.approx(dissipated[2:].sum(), abs=1e-5)


def test_a_large_loop_has_the_area_of_its_parallelogram() -> None:
    """Between 0 and P each element slips over P - 2 r both ways: 2 r w (P - 2 r)."""
    path = along([0.7, 0.0, 0.7], 5000)
    push, p = played(hysteresis(), path)[:, 0], path[:, 0]
    loop = slice(10_000 - 1, 20_000)
    area = (0.5 * (p[loop][1:] + p[loop][:-1]) * np.diff(push[loop])).sum()
    assert area == pytest.approx(2 * 0.02 * 0.05 * (0.7 - 0.04) + 2 * 0.1 * 0.04 * (0.7 - 0.2), rel=1e-3)


def test_softening_follows_the_peak_at_first_and_ends_after_some_cycles() -> None:
    effect = SofteningSection.model_validate(SOFTENING).effect(1, ARM_STEP_S)
    cycles = [played(effect, along([0.6], 60)) for _ in range(12)]
    up, down = cycles[0][29, 0], cycles[0][89, 0]
    assert down > up * 1.01
    peaks = np.array([cycle.max() for cycle in cycles])
    assert (np.diff(peaks) > 0).all()
    np.testing.assert_allclose(
        peaks[0], 0.6 * (1 + 0.04 * (1 - math.exp(-2)) + 0.02 * (1 - math.exp(-0.3))), rtol=1e-12
    )
    assert peaks[-1] - peaks[-2] < 0.01 * (peaks[-1] - 0.6)
    assert cycles[-1][-1, 0] == 0.0


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        (PUSH, [0.2 * 1.03, 0.4 * 1.06, 0.0]),
        (PUSH_SUM, [0.2 * 1.09, 0.4 * 1.09, 0.0]),
        (GAINS, [0.2, 0.412, 0.0]),
        (COUPLING, [0.22, 0.41, 0.03]),
    ],
    ids=["own push", "sum push", "gains", "coupling"],
)
def test_an_effect_without_memory_is_its_formula(entry: dict[str, object], expected: list[float]) -> None:
    (section,) = simulated([entry]).arm_effects
    effect = section.effect(3, ARM_STEP_S)
    for _ in range(2):
        assert effect([0.2, 0.4, 0.0]) == pytest.approx(expected, abs=1e-15)


def test_these_tests_cover_every_registered_effect() -> None:
    assert {type(section) for section in simulated(EVERY).arm_effects} == set(ARM_EFFECTS.built_in.values())


def test_every_effect_leaves_an_arm_without_pressure_alone() -> None:
    for section in simulated(EVERY).arm_effects:
        assert section.effect(3, ARM_STEP_S)([0.0, 0.0, 0.0]) == [0.0, 0.0, 0.0]


def bent(plant: Plant) -> Plant:
    """Chamber 1 filled through the open valve for a moment, then closed."""
    card = plant.card("daq")
    card.write(np.array([8.0, 0.0]))
    plant.advance(60_000_000)
    card.write(np.array([5.0, 0.0]))
    plant.advance(1_500_000_000)
    return plant


def test_the_tip_goes_where_the_effective_pressures_put_the_true_arm() -> None:
    effects = [PUSH, GAINS, COUPLING]
    config = mock_rig(**STILL, simulator__arm_effects=effects)
    plant = bent(Plant(config, 1, 0))
    pressure_bar = (plant.pressure_pa * 1e-5).tolist()
    for section in simulated(effects).arm_effects:
        pressure_bar = section.effect(3, ARM_STEP_S)(pressure_bar)
    shape = statics(true_arm(config), np.array(pressure_bar) * 1e5)
    np.testing.assert_allclose(plant.pose_at(plant.t_ns).position_m, shape.tip_m, atol=2e-5)
    ideal = statics(true_arm(config), plant.pressure_pa)
    assert np.linalg.norm(ideal.tip_m - shape.tip_m) > 1e-3


def test_a_plant_with_every_effect_repeats_bit_for_bit_however_time_is_cut() -> None:
    config = mock_rig(simulator__arm_effects=EVERY)
    one, other = bent(Plant(config, 1, 0)), Plant(config, 1, 0)
    card = other.card("daq")
    card.write(np.array([8.0, 0.0]))
    for t_ns in range(0, 60_000_001, 1_700_000):
        other.advance(t_ns)
    other.advance(60_000_000)
    card.write(np.array([5.0, 0.0]))
    for t_ns in range(60_000_000, 1_500_000_001, 3_300_000):
        other.advance(t_ns)
    other.advance(1_500_000_000)
    assert one.poses_since(0).tobytes() == other.poses_since(0).tobytes()


def test_mock_ideal_is_mock_without_effects() -> None:
    ideal, mock = loader.load("mock-ideal"), loader.load("mock")
    assert ideal.simulator is not None
    assert mock.simulator is not None
    assert ideal.simulator.arm_effects == ()
    assert ideal.simulator == mock.simulator.model_copy(update={"arm_effects": ()})
    assert ideal.arm == mock.arm


@pytest.mark.parametrize(
    ("entry", "field", "expected"),
    [
        ({"type": "kreep"}, "type", "one of coupling, creep, gains, hysteresis, push, softening"),
        ({"type": "gains", "gains": [1.0, 1.1]}, "gains", "3 of them, one for each actuator"),
        ({"type": "creep", "branches": []}, "branches", "at least one item"),
        ({"type": "push", "per_bar": 0.1, "pressure": "total"}, "pressure", "one of own, sum"),
        ({"type": "hysteresis", "elements": [{"weight": 0.1, "slip_bar": 0.0}]}, "slip_bar", "a number above 0"),
    ],
    ids=["unknown type", "gains of two", "no branch", "unknown pressure", "no threshold"],
)
def test_a_bad_effect_is_reported_with_its_line(entry: dict[str, object], field: str, expected: str) -> None:
    written = loader.text("mock-ideal") + "  arm_effects:\n    - " + yaml.safe_dump(entry, default_flow_style=True)
    with pytest.raises(BadInputError) as caught:
        loader.parse(written, "rig.yaml")
    (problem,) = caught.value.problems
    assert expected in str(problem)
    assert re.search(rf"rig.yaml:{len(written.splitlines())}\b.*", str(problem)), str(problem)
    assert field in str(problem)


def simulated(entries: list[dict[str, object]]) -> Simulator:
    found = mock_rig(simulator__arm_effects=entries).simulator
    assert found is not None
    return found
