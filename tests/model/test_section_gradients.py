"""Sections of the arm, at rest and in motion: their poses on a fine grid, and gradients against whole solutions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from model import Arm, sensitivities
from model.sensitivities import Gradients
from model.statics import statics
from model.variation import Variation

BAR = 1e5
ARM = replace(Arm.paper(), rod_weight=True).with_segment(material=replace(Arm.paper().material, damping_s=0.01))
LENGTH = ARM.geometry.length_m
# Of the nodes and between them, at both ends, too.
AT_M = np.array([0.0, 0.25, 0.613, 0.95]) * LENGTH
RESTING = np.array([[0.3, 0.1, 0.5], [0.55, 0.2, 0.05]]) * BAR
MOVING = np.stack([0.3 + 0.2 * np.sin(0.3 * np.arange(9)), np.full(9, 0.1), 0.2 * (np.arange(9) > 3)], axis=1) * BAR
STEP = 1e-7


def stiffer(x: float) -> Arm:
    return ARM.with_segment(material=replace(ARM.material, a1_per_n=ARM.material.a1_per_n * (1 + x)))


def sheared(x: float) -> Arm:
    return ARM.with_segment(material=replace(ARM.material, shear_ratio=ARM.material.shear_ratio * (1 + x)))


def longer(x: float) -> Arm:
    return ARM.with_segment(geometry=replace(ARM.geometry, length_m=LENGTH * (1 + x)))


STIFFNESS_SLOPES: tuple[Callable[[float], Arm], ...] = (stiffer, sheared, longer)


def at_rest(arm: Arm, changes: tuple[Variation, ...] = ()) -> Gradients:
    return sensitivities.statics(arm, RESTING, changes, np.array([0.0, 0.2]), sections_m=AT_M)


def in_motion(arm: Arm, changes: tuple[Variation, ...] = ()) -> Gradients:
    return sensitivities.motion(arm, MOVING, 0.025, changes, every=2, sections_m=AT_M)


@pytest.mark.parametrize("solve", [at_rest, in_motion])
def test_gradients_of_sections_are_those_of_whole_solutions(
    monkeypatch: pytest.MonkeyPatch, solve: Callable[..., Gradients]
) -> None:
    monkeypatch.setattr("model.sensitivities.TOLERANCE_IN_MOTION", 1e-7)
    found = solve(ARM, tuple(Variation(STEP, change(STEP)) for change in STIFFNESS_SLOPES))
    assert found.section_m.shape == (len(found.tip_m), len(AT_M), 3)
    for k, change in enumerate(STIFFNESS_SLOPES):
        h = 2e-3
        more, less = solve(change(h)), solve(change(-h))
        expected = (more.section_m - less.section_m) / (2 * h)
        assert found.section_by[..., k] == pytest.approx(expected, rel=1e-4, abs=2e-7)
        between = more.section_rotation @ np.swapaxes(less.section_rotation, -1, -2)
        turned = Rotation.from_matrix(between.reshape(-1, 3, 3)).as_rotvec().reshape(expected.shape) / (2 * h)
        assert found.section_turn_by[..., k] == pytest.approx(turned, rel=1e-4, abs=2e-6)


def test_sections_at_rest_are_those_of_the_shape_on_a_fine_grid() -> None:
    found = sensitivities.statics(ARM, RESTING, sections_m=AT_M)
    for k, pressure in enumerate(RESTING):
        place, rotation = statics(ARM, pressure, nodes=400).frames_at(AT_M)
        assert found.section_m[k] == pytest.approx(place, abs=1e-8)
        assert found.section_rotation[k] == pytest.approx(rotation, abs=1e-6)


def test_the_section_at_the_end_is_the_tip() -> None:
    changes = (Variation(STEP, stiffer(STEP)),)
    for solve in (
        lambda: sensitivities.statics(ARM, RESTING, changes, sections_m=[LENGTH]),
        lambda: sensitivities.motion(ARM, MOVING, 0.025, changes, sections_m=[LENGTH]),
    ):
        found = solve()
        assert found.section_m[:, 0] == pytest.approx(found.tip_m, abs=1e-12)
        assert found.section_rotation[:, 0] == pytest.approx(found.tip_rotation, abs=1e-12)
        assert found.section_by[:, 0] == pytest.approx(found.tip_by, abs=1e-9)
        assert found.section_turn_by[:, 0] == pytest.approx(found.turn_by, abs=1e-9)


@pytest.mark.parametrize("at_m", [-0.001, LENGTH + 0.001, np.nan])
def test_a_section_beyond_the_arm_is_refused(at_m: float) -> None:
    with pytest.raises(ValueError, match="sections lie on the arm"):
        sensitivities.statics(ARM, RESTING, sections_m=[at_m])
