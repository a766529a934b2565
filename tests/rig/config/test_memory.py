"""Branches and stop elements of a rig file: read, refused, identified, and in the model beside a run and its replay."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.identify import Setup, identify
from calibration.identify.observations.data import quasi_static_poses
from calibration.identify.prediction.tip_predictor import Predictor
from calibration.identify.presentation.parameters_document import write
from calibration.identify.simulated_experiments import MeasurementErrors, perform, plan_slow
from model.actuation import StopElement
from model.dynamics import Dynamics
from model.material import MaxwellBranch
from protocols import BadInputError
from rig.config import loader
from rig.config.arm_model import model_arm, true_arm
from rig.config.loader import load, text
from rig.config.parameters_overlay import read
from rig.experiment.replay import replay
from rig.hardware.cameras.base import FrameSet
from rig.observation.observer import Observer
from runs.run import Run
from tests.support.control_cycles import control_cycles
from tests.support.virtual_runs import virtual_run

pytestmark = pytest.mark.slow

MEMORY = "branches: [{relative_modulus: 0.05, time_s: 2.0}]"
STOPS = "{stops: [{weight: 0.08, width_bar: 0.02}]}"
PROTOCOL = """title: A level
steps:
  - ramp: {actuators: [1], to_bar: 0.4, duration_s: 0.5}
  - hold: {duration_s: 1.5}
"""


def rig_file(folder: Path, branches: str = MEMORY, actuation: str = STOPS, mode: str = "static") -> Path:
    """The mock's rig file with lines on what the model remembers."""
    written = text("mock-ideal")
    for pattern, line in (
        (r"\n    shear_ratio: 0.4094", f"\n    {branches}\\g<0>"),
        (r"\n  cap_mass_g: 50", f"\n  actuation: {actuation}\\g<0>"),
        (r"\nsimulator:", f"\nmodel: {{mode: {mode}}}\n\\g<0>"),
    ):
        written, count = re.subn(pattern, line, written, count=1)
        assert count == 1
    file = folder / "rig.yaml"
    file.write_text(written, encoding="utf-8")
    return file


def test_memory_is_that_of_the_model_and_not_of_the_simulated_arm(tmp_path: Path) -> None:
    config = load(rig_file(tmp_path))
    assert model_arm(config).material.branches == (MaxwellBranch(0.05, 2.0),)
    assert model_arm(config).actuation.stops == (StopElement(0.08, 2e3),)
    assert not true_arm(config).remembers
    assert not model_arm(load("mock")).remembers


@pytest.mark.parametrize(
    ("branches", "actuation", "word"),
    [
        ("branches: [{relative_modulus: -0.1, time_s: 2.0}]", STOPS, "relative_modulus"),
        ("branches: [{relative_modulus: 0.1, time_s: 0.0}]", STOPS, "time_s"),
        (MEMORY, "{stops: [{weight: 1.2, width_bar: 0.02}]}", "weight"),
        (MEMORY, "{stops: [{weight: 0.2, width_bar: 0.0}]}", "width_bar"),
        (f"branches: [{', '.join(['{relative_modulus: 0.1, time_s: 1.0}'] * 4)}]", STOPS, "branches"),
    ],
)
def test_impossible_numbers_are_refused_with_their_line(
    tmp_path: Path, branches: str, actuation: str, word: str
) -> None:
    with pytest.raises(BadInputError) as caught:
        load(rig_file(tmp_path, branches, actuation))
    (problem,) = caught.value.problems
    assert problem.line > 0
    assert word in problem.where


def observed(observer: Observer, t_s: float, pressure_pa: list[float], first_s: float) -> np.ndarray:
    """Model tip [m] of a frame at a time, with samples under constant pressures since another."""
    samples = np.arange(round(first_s * 1e9), round(t_s * 1e9) + 1, 5_000_000)
    rows = np.tile(pressure_pa, (len(samples), 1))
    row = observer.step(FrameSet(round(t_s * 30), (), round(t_s * 1e9)), control_cycles(samples, rows), t_s)
    assert row["model_ok"]
    return np.array(row["model_m"])


def test_a_slow_model_creeps_with_the_times_of_the_frames_and_over_gaps(tmp_path: Path) -> None:
    file = rig_file(tmp_path, actuation="{law: proportional}")
    written = re.sub(r"\ncameras:.*?\nboard:.*?\n(?=\n?arm:)", "\n", file.read_text(encoding="utf-8"), flags=re.DOTALL)
    file.write_text(written, encoding="utf-8")
    config = load(file)
    arm, pressed = model_arm(config), [0.3e5, 0.0, 0.0]
    observer = Observer(config)
    observed(observer, 0.0, [0.0, 0.0, 0.0], 0.0)
    times = [0.04, 0.1, 0.5, 3.1]
    tips = [observed(observer, t, pressed, t - 0.02) for t in times]
    fine = Dynamics(replace(arm, inertia=False), 0.005)
    fine.start((0, 0, 0))
    course = fine.run([pressed] * 620).tip_m
    away = np.linalg.norm(course[-1] - course[7])
    assert away > 4e-4
    for t, tip in zip(times[1:], tips[1:], strict=True):
        assert np.linalg.norm(tip - course[round(t / 0.005) - 1]) < 0.06 * away


def test_the_model_beside_a_run_its_replay_and_its_identification_remember_alike(tmp_path: Path) -> None:
    file, protocol = rig_file(tmp_path), tmp_path / "level.yaml"
    protocol.write_text(PROTOCOL, encoding="utf-8")
    live = virtual_run(protocol, file, folder=tmp_path, seed=4)
    tips = []
    for run in (live, Run(replay(live, tmp_path))):
        known = {q.name: q.value for q in run.header.quantities if q.name.startswith(("branch_", "stop_"))}
        assert known == {
            "branch_1_modulus": (0.05,), "branch_1_time": (2.0,), "stop_1_weight": (0.08,), "stop_1_width": (0.02,),
        }  # fmt: skip
        tips.append(run.tip.model_mm[run.tip.frame == 57][0])
    assert tips[1] == pytest.approx(tips[0], abs=0.02)
    arm = model_arm(load(file))
    poses = quasi_static_poses(live)
    predicted = 1e3 * Predictor(poses)(Setup(arm))[57]
    elastic = replace(arm, actuation=replace(arm.actuation, stops=())).with_segment(
        material=replace(arm.material, branches=())
    )
    forgetful = 1e3 * Predictor(poses)(Setup(elastic))[57]
    assert np.linalg.norm(tips[0] - forgetful) > 0.5
    assert np.linalg.norm(tips[0] - predicted) < 0.1


def test_memory_is_identified_and_its_file_applies_to_a_rig_with_as_much_only(tmp_path: Path) -> None:
    file = rig_file(tmp_path)
    start = Setup(model_arm(load(file)))
    material = replace(start.arm.material, branches=(MaxwellBranch(0.08, 3.0),))
    actuation = replace(start.arm.actuation, stops=(StopElement(0.05, 3e3),))
    truth = replace(start, arm=replace(start.arm, actuation=actuation).with_segment(material=material))
    corners = np.repeat([0.0, 0.5, 0.46, 0.5, 0.3, 0.6, 0.56, 0.1, 0.4, 0.0], 2)
    levels = 1e5 * np.interp(np.arange(0, 19, 0.1), np.arange(20), corners)[:, None]
    planned = [plan_slow("a", levels * [1.0, 0, 0], 0.25), plan_slow("b", levels * [0, 0.8, 0.5], 0.25)]
    data = [perform(one, truth, np.random.default_rng(3), MeasurementErrors(offset_pa=0.0)) for one in planned]
    free = ["branch_1_modulus", "branch_1_time_s", "stop_1_weight", "stop_1_width_pa"]
    fit = identify(data, start, free)
    for name, true in zip(free, (0.08, 3.0, 0.05, 3e3), strict=True):
        found = fit[name]
        assert found.std is not None
        assert abs(found.used - true) < 3.5 * found.std < true
    written = write(fit, tmp_path / "arm.yaml")
    laid = loader.read(str(file)).identified(read(written)).config.arm
    assert laid.material.branches[0].time_s == pytest.approx(fit["branch_1_time_s"].used)
    assert laid.actuation.stops[0].width_bar == pytest.approx(fit["stop_1_width_pa"].used * 1e-5)
    with pytest.raises(BadInputError) as caught:
        loader.read("mock").identified(read(written))
    assert [p.expected for p in caught.value.problems] == ["0, as mock.yaml has"] * 2
