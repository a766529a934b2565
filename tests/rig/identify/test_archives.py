"""From archives alone: runs of the mock rig give the arm that hangs in it; online, the live error shrinks."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import model
from calibration.identify import NoDataError, Prior, Setup, at_rest, identify, in_motion, poses_of, split_at
from calibration.identify.recursive_estimator import RecursiveEstimator
from model.dynamics import Dynamics
from model.statics import statics
from rig.config.arm_model import model_arm, true_arm
from rig.config.loader import load
from rig.config.parameters_overlay import read
from runs.run import Run
from tests.support.command_line import status_of
from tests.support.virtual_runs import virtual_run

pytestmark = pytest.mark.slow

AT_REST = """
title: Three pressures of each case, and two weights
steps:
  - hold: {duration_s: 2.5}
  - staircase: {actuators: [1], start_bar: 0.2, stop_bar: 0.6, step_bar: 0.2, dwell_s: 2.5}
  - ramp: {actuators: [1], to_bar: 0, duration_s: 1.5, shape: smooth}
  - staircase: {actuators: [2, 3], start_bar: 0.2, stop_bar: 0.6, step_bar: 0.2, dwell_s: 2.5}
  - ramp: {actuators: [2, 3], to_bar: 0, duration_s: 1.5, shape: smooth}
  - prompt: {message: Hang 500 g., weight_g: 500}
  - hold: {duration_s: 2.5}
  - prompt: {message: Hang 1100 g., weight_g: 1100}
  - hold: {duration_s: 2.5}
"""
IN_MOTION = """
title: Two periods of actuator 1
steps:
  - sine: {actuators: [1], mean_bar: 0.35, amplitude_bar: 0.25, omega_rad_s: 1.4, periods: 2, lead_in_s: 1}
"""


def performed(folder: Path, text: str, seed: int) -> Run:
    file = folder / "protocol.yaml"
    file.write_text(text, encoding="utf-8")
    return virtual_run(file, "mock-ideal", folder=folder, seed=seed)


@pytest.fixture(scope="module")
def resting(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return performed(tmp_path_factory.mktemp("rest"), AT_REST, 21)


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return performed(tmp_path_factory.mktemp("motion"), IN_MOTION, 22)


def test_plateaus_are_the_levels_that_the_protocol_held(resting: Run) -> None:
    poses = at_rest(resting)
    levels = np.round(poses.pressure_pa / 1e5, 1)
    expected = [[0, 0, 0], *[[p, 0, 0] for p in (0.2, 0.4, 0.6)], *[[0, p, p] for p in (0.2, 0.4, 0.6)]]
    assert [list(level) for level in levels[:7]] == expected
    assert poses.weight_kg[-2:] == pytest.approx([0.5, 1.1])
    assert resting.simulated is not None
    # Every plateau's tip within five of its own standard deviations of the simulator's truth.
    tip = resting.simulated.tip_mm
    for measured, covariance in zip(poses.tip_m, poses.covariance_m2, strict=True):
        gap = np.linalg.norm(tip / 1e3 - measured, axis=1).min()
        assert gap < 5 * np.sqrt(np.trace(covariance)) + 2e-5


def test_a_moving_run_is_used_as_a_motion_and_a_resting_one_by_its_plateaus(resting: Run, moving: Run) -> None:
    assert not poses_of(resting).moving
    assert poses_of(moving).moving
    with pytest.raises(NoDataError, match="no plateau longer"):
        at_rest(moving, settle_s=5.0)


def test_the_arm_of_the_mock_rig_is_identified_from_its_archive(resting: Run) -> None:
    config = load("mock")
    free, priors = ["law", "rpe_per_bar", "cap_mass_kg", "sensor_offsets"], {"sensor_offsets": Prior(0.0, 300.0)}
    fit = identify([at_rest(resting)], Setup(model_arm(config)), free, priors)
    truth = Setup(true_arm(config))
    expected = {
        "a1_per_n": truth.arm.material.a1_per_n,
        "a2_per_n2": truth.arm.material.a2_per_n2,
        "rpe_per_bar": truth.arm.material.rpe_per_bar,
        "cap_mass_kg": truth.arm.cap_mass_kg,
    }
    for name, true in expected.items():
        estimate = fit[name]
        assert estimate.value is not None, name
        assert estimate.std is not None
        assert abs(estimate.value - true) < 4 * estimate.std
    # An arm that differs by a few per cent from the published one is identified as different.
    a1 = fit["a1_per_n"]
    assert a1.std is not None
    assert a1.std < 0.02 * expected["a1_per_n"]
    assert fit.runs[0].rms_m < 0.2 * fit.runs[0].rms_before_m


def test_adapting_at_least_halves_the_live_error_after_one_period(moving: Run) -> None:
    config = load("mock")
    arm, truth = model_arm(config), true_arm(config)
    poses = in_motion(moving)
    adapter = RecursiveEstimator(
        Setup(arm), ["law", "rpe_per_bar", "sensor_offsets"], {"sensor_offsets": Prior(0.0, 200.0)}
    )
    dynamics = Dynamics(arm, poses.period_s)
    published, adapted = [], []
    for k, pressure in enumerate(poses.pressure_pa):
        shape = dynamics.start(pressure) if k == 0 else dynamics.step(pressure)
        motion = shape.tip_m - statics(arm, pressure).tip_m
        step = adapter.step(pressure, poses.tip_m[k], poses.covariance_m2[k], motion)
        published.append(np.linalg.norm(poses.tip_m[k] - shape.tip_m))
        adapted.append(np.linalg.norm(poses.tip_m[k] - step.predicted_m))
    after = slice(round((1 + 2 * np.pi / 1.4) / poses.period_s), None)
    assert np.mean(adapted[after]) < 0.5 * np.mean(published[after])
    for name in ("a1_per_n", "a2_per_n2", "rpe_per_bar"):
        i = adapter.names.index(name)
        assert abs(adapter.values[i] - getattr(truth.material, name)) < (3 * adapter.std[i])


def test_a_missing_or_outlying_tip_does_not_spoil_the_estimate() -> None:
    arm = model_arm(load("mock"))
    adapter = RecursiveEstimator(Setup(arm), ["law"])
    pressure, covariance = np.array([0.4e5, 0.0, 0.0]), np.eye(3) * 1e-8
    before = adapter.values
    adapter.step(pressure, np.full(3, np.nan), covariance)
    assert (adapter.values == before).all()
    adapter.step(pressure, statics(arm, pressure).tip_m + 0.5, covariance)
    assert (np.abs(adapter.values - before) < 0.5 * before).all()
    assert np.isfinite(adapter.std).all()


def test_rig_identify_writes_a_rig_file_with_the_identified_arm(
    resting: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = tmp_path / "found.yaml"
    assert status_of("identify", resting.path, "--free", "law,rpe_per_bar,sensor_offsets", "--rig-file", found) == 0
    assert "a1_per_n" in capsys.readouterr().out
    published, true, identified = model_arm(load("mock")), true_arm(load("mock")), model_arm(load(str(found)))

    def gap(arm: model.Arm) -> float:
        pressure = [0.6e5, 0.0, 0.0]
        return float(np.linalg.norm(statics(arm, pressure).tip_m - statics(true, pressure).tip_m))

    assert gap(identified) < 0.25 * gap(published)


def test_rig_identify_reports_an_invalid_request(resting: Run, capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of("identify", resting.path, "--free", "a1_per_m") == 2
    assert "did you mean" in capsys.readouterr().err


def test_a_sensor_at_the_foot_of_its_scale_shows_only_that_the_pressure_is_low(resting: Run) -> None:
    poses = at_rest(resting)
    sensors = [q for q in resting.header.quantities if q.name.endswith("_offset") and q.name.startswith("sensor_")]
    foot_pa = np.array([q.value[0] * 1e5 for q in sensors])
    doubt = poses.pressure_std_pa > 200
    vented, pressed = poses.pressure_pa < 2e3, poses.pressure_pa > 1e4
    touching = (resting.pressure.measured_bar * 1e5 <= foot_pa).sum(axis=0)
    lowest = int(np.argmax(touching))
    assert touching[lowest] > 100
    assert doubt[vented[:, lowest], lowest].all()
    assert not doubt[pressed].any()


def test_a_motion_is_split_at_its_tips_and_keeps_its_pressures(moving: Run) -> None:
    whole = in_motion(moving)
    middle_s = float(whole.time_s[len(whole) // 2])
    before, after = split_at(whole, middle_s)
    assert (before.time_s[before.has_tip] < middle_s).all()
    assert (after.time_s[after.has_tip] >= middle_s).all()
    assert np.array_equal(before.has_tip ^ after.has_tip, whole.has_tip)
    for part in (before, after):
        assert np.array_equal(part.pressure_pa, whole.pressure_pa)


def test_a_plateau_belongs_to_the_part_in_which_it_ends(resting: Run) -> None:
    whole = at_rest(resting)
    assert (np.diff(whole.time_s) > 0).all()
    before, after = split_at(whole, float(whole.time_s[1]))
    assert (len(before), len(after)) == (1, len(whole) - 1)
    with pytest.raises(NoDataError, match="no tip after"):
        split_at(whole, 1e6)


def test_the_orientation_of_the_board_is_used_and_reported(
    resting: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found, page = tmp_path / "arm.yaml", tmp_path / "page.html"
    assert status_of("identify", resting.path, "--to", found, "--report", page) == 0
    said = capsys.readouterr().out
    used, frames, rms_deg = re.findall(r"orientation of the tip used in (\d+) of (\d+) frames: rms ([\d.]+) deg", said)[
        0
    ]
    assert used == frames
    # The simulated arm obeys the model: what is left is the error of the pictures.
    assert float(rms_deg) < 0.05
    (data,) = read(found).found.data
    assert data["oriented_frames"] == int(used)
    assert data["rms_deg"] == pytest.approx(float(rms_deg), abs=0.01)
    assert "rms angle, measured to model orientation" in page.read_text()


def test_the_orientation_of_the_board_is_measured_as_well_as_stated(resting: Run) -> None:
    poses = at_rest(resting)
    assert poses.has_orientation.all()
    free = ["law", "rpe_per_bar", "cap_mass_kg", "length_m", "base", "tool", "tool_rotation", "sensor_offsets"]
    priors = {"sensor_offsets": Prior(0.0, 300.0)}
    fit = identify([poses], Setup(model_arm(load("mock-ideal"))), free, priors)
    assert fit.noise.extra["tip rotation"] < np.deg2rad(0.01)
    blind = identify([replace(poses, orientation=None)], Setup(model_arm(load("mock-ideal"))), free, priors)
    assert blind["base_ry_rad"].posterior_std > 3 * fit["base_ry_rad"].posterior_std
