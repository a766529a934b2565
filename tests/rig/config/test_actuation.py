"""The actuation law of a rig file: read, refused, identified, and used by the model that runs beside the rig."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.identify import Setup, identify
from calibration.identify.presentation.parameters_document import write
from calibration.identify.simulated_experiments import MeasurementErrors, perform, plan
from model.actuation import PressureSum, Proportional
from model.dynamics import Dynamics
from protocols import BadInputError, Problem
from rig.config import loader
from rig.config.arm_model import model_arm, true_arm
from rig.config.loader import load, recorded, text
from rig.config.parameters_overlay import read
from rig.experiment.replay import replay
from rig.observation.online_estimation import default_parameters
from runs.run import Run
from tests.support.virtual_runs import virtual_run

PROTOCOL = """title: A level
steps:
  - ramp: {actuators: [1], to_bar: 0.4, duration_s: 0.5}
  - hold: {duration_s: 0.5}
"""


def rig_file(folder: Path, actuation: str) -> Path:
    """The mock's rig file with a line on the actuation."""
    written, count = re.subn(r"\n  cap_mass_g: 50", f"\n  actuation: {actuation}\\g<0>", text("mock"), count=1)
    assert count == 1
    file = folder / "rig.yaml"
    file.write_text(written, encoding="utf-8")
    return file


def problem_of(folder: Path, actuation: str) -> Problem:
    with pytest.raises(BadInputError) as caught:
        load(rig_file(folder, actuation))
    (problem,) = caught.value.problems
    return problem


def test_the_law_is_that_of_the_model_and_not_of_the_simulated_arm(tmp_path: Path) -> None:
    config = load(rig_file(tmp_path, "{law: pressure-sum, growth_per_bar: 0.3}"))
    assert model_arm(config).actuation == PressureSum(0.3)
    assert true_arm(config).actuation == Proportional()
    assert model_arm(load("mock")).actuation == Proportional()


def test_an_unknown_law_and_a_growth_that_the_law_has_not_are_refused_with_their_line(tmp_path: Path) -> None:
    unknown = problem_of(tmp_path, "{law: square}")
    assert unknown.line > 0
    assert "proportional, own-pressure, pressure-sum" in unknown.expected
    assert "growth_per_bar must be 0" in problem_of(tmp_path, "{growth_per_bar: 0.3}").expected


def test_the_growth_is_free_by_default_where_the_push_grows(tmp_path: Path) -> None:
    config = load(rig_file(tmp_path, "{law: own-pressure}"))
    assert set(default_parameters(config)) - set(default_parameters(load("mock"))) == {"push_growth_per_bar"}


def test_the_growth_is_identified_and_its_file_applies_to_a_rig_of_the_same_law_only(tmp_path: Path) -> None:
    file = rig_file(tmp_path, "{law: pressure-sum, growth_per_bar: 0.1}")
    start = Setup(model_arm(load(file)))
    truth = Setup(replace(start.arm, actuation=PressureSum(0.25)))
    levels = np.linspace(0.0, 0.6e5, 7)[:, None]
    planned = [plan("a", levels * np.array([1.0, 0, 0])), plan("b", levels * np.array([0, 1.0, 1.0]))]
    moving = plan("c", np.outer(np.linspace(0.0, 0.5e5, 60), [0.5, 1.0, 0.0]), period_s=1 / 30)
    data = [
        perform(one, truth, np.random.default_rng(3), MeasurementErrors(offset_pa=0.0)) for one in (*planned, moving)
    ]
    for some in (data[:2], data[2:]):
        found = identify(some, start, ["push_growth_per_bar"])["push_growth_per_bar"]
        assert found.std is not None
        assert abs(found.used - 0.25) < 3 * found.std < 0.1
    written = write(identify(data[:2], start, ["push_growth_per_bar"]), tmp_path / "arm.yaml")
    laid = loader.read(str(file)).identified(read(written)).config.arm.actuation
    assert laid.law == "pressure-sum"
    assert laid.growth_per_bar == pytest.approx(0.25, abs=0.05)
    with pytest.raises(BadInputError) as caught:
        loader.read("mock").identified(read(written))
    assert "proportional, the actuation law of mock" in caught.value.problems[0].expected


def test_the_model_beside_a_run_and_in_its_replay_pushes_by_the_law(tmp_path: Path) -> None:
    file, protocol = rig_file(tmp_path, "{law: pressure-sum, growth_per_bar: 0.3}"), tmp_path / "level.yaml"
    protocol.write_text(PROTOCOL, encoding="utf-8")
    live = virtual_run(protocol, file, folder=tmp_path, seed=4)
    for run in (live, Run(replay(live, tmp_path))):
        config = recorded(run.header, run.path).config
        (growth,) = (q for q in run.header.quantities if q.name == "push_growth")
        assert growth.value == (0.3,)
        grown, plain = model_arm(config), replace(model_arm(config), actuation=Proportional())
        pressure = 1e5 * run.pressure.measured_bar[-20:].mean(axis=0)
        tips = []
        for arm in (grown, plain):
            dynamics = Dynamics(arm, 1 / 30)
            dynamics.start(pressure)
            tips.append(1e3 * dynamics.step(pressure).tip_m)
        assert np.linalg.norm(tips[0] - tips[1]) > 3
        assert run.tip.model_mm[-1] == pytest.approx(tips[0], abs=0.5)
