"""Tip paths of an arm with more valves than coordinates."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import protocols
from calibration.identify.unknowns.parameters import known
from calibration.identify.unknowns.segments import known_of
from calibration.identify.unknowns.setup import Setup
from model.statics import statics
from rig.config.arm_model import model_arm
from rig.config.loader import load
from rig.tip_planning.assessment import assess
from rig.tip_planning.inverse import RigTipInverse
from tests.support.command_line import status_of
from tests.support.virtual_runs import protocol_file

CIRCLE = """\
  - hold: {duration_s: 0.3}
  - tip: {circle: {centre_mm: [0, 0, 228], radius_mm: 15, period_s: 8, periods: 1}, lead_in_s: 3}
  - ramp: {actuators: [1, 2, 3, 4, 5, 6], to_bar: 0, duration_s: 2, shape: smooth}
"""


def test_six_pressures_lead_the_tip_along_a_circle_within_their_limits(tmp_path: Path) -> None:
    config = load("mock-two-sections")
    trajectory = protocols.load(str(protocol_file(tmp_path, CIRCLE))).expand(6, RigTipInverse(config))
    (motion,) = trajectory.tip.motions
    on_path = motion.times_s >= motion.path_s
    off_mm = 1e3 * np.linalg.norm((motion.predicted_m - motion.position_m)[on_path], axis=1)
    assert off_mm.max() < 0.1
    pressure_bar = trajectory.sample(motion.times_s[on_path]) / 1e5
    assert pressure_bar.min() >= 0
    assert pressure_bar.max() <= config.limits.pressure_bar
    assert np.ptp(pressure_bar, axis=0).min() > 0.02, "chambers of both segments take part"


def test_the_expected_error_of_a_path_names_the_numbers_of_each_segment(tmp_path: Path) -> None:
    config = load("mock-two-sections")
    trajectory = protocols.load(str(protocol_file(tmp_path, CIRCLE))).expand(6, RigTipInverse(config))
    (path,) = assess(config, trajectory)
    assert 0.2 < path.expected_error_mm < 20
    assert all(share > 0 for _, share in path.causes)
    assert any(name.startswith("segment_") for name, _ in path.causes)


def test_a_number_of_a_segment_changes_that_segment_alone() -> None:
    arm = model_arm(load("mock-two-sections"))
    every, start = known_of(arm), Setup(arm)
    assert "a1_per_n" not in every
    second = every["segment_2.a1_per_n"]
    assert second.read(start) == 0.0121
    changed = second.write(start, 0.013).arm
    assert changed.segments[1].material.a1_per_n == 0.013
    assert changed.segments[1].coupling == arm.segments[1].coupling
    assert changed.segments[0] == arm.segments[0]
    longer = every["segment_1.length_m"].write(start, 0.111).arm
    assert longer.length_m == pytest.approx(0.216)
    turned = every["actuator_5_turn_rad"].write(start, 0.1).turned_arm
    assert turned.segments[0] == arm.segments[0]
    x, y = np.subtract(turned.segments[1].geometry.actuator_xy_m[1], arm.segments[1].geometry.actuator_xy_m[1])
    assert np.hypot(x, y) == pytest.approx(2 * 0.024 * np.sin(0.05))
    pressure = np.full(6, 0.2e5)
    assert not np.array_equal(statics(changed, pressure).tip_m, statics(arm, pressure).tip_m)


def test_an_arm_of_one_segment_has_the_plain_names() -> None:
    assert list(known_of(model_arm(load("mock")))) == list(known(3))


@pytest.mark.slow
def test_rig_check_judges_the_path(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of("check", protocol_file(tmp_path, CIRCLE), "--rig", "mock-two-sections") == 0
    assert "segment_" in capsys.readouterr().out
