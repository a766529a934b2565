"""A measured tip force is the load of the model: live, in replay and in identification."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import runs
from calibration.identify.errors import NoDataError
from calibration.identify.observations.data import at_rest, in_motion
from model.statics import statics
from model.units import GRAVITY_M_S2
from protocols import BadInputError
from rig.config.arm_model import TipLoad, model_arm
from rig.config.loader import load, read, text
from rig.experiment.replay import replay
from rig.hardware.cameras.base import FrameSet
from rig.observation.observer import Observer
from runs.run import Run
from tests.support.changed_archive import changed
from tests.support.command_line import status_of
from tests.support.control_cycles import control_cycles
from tests.support.plant_bench import mock_rig
from tests.support.virtual_runs import virtual_run

WEIGHT_KG = 0.5
LOAD = "load: {card: daq, channel: 4, unit: N, span: [-5, 45], tip_force_direction: [0, 0, 2]}"
TRUTH = "\nsimulator:\n  inputs: {load: {rest: 0, per_g: 0.00981}}"
PROTOCOL = """
title: A weight
steps:
  - hold: {duration_s: 0.4}
  - prompt: {message: Hang it., weight_g: 500}
  - hold: {duration_s: 2.5}
"""


def rig_file(folder: Path, inputs: str, base: str = "mock-ideal") -> Path:
    """A mock with auxiliary inputs, a weight on whose cap pulls at the input `load`."""
    rig = folder / "rig.yaml"
    rig.write_text(text(base).replace("\nlimits:", f"\n{inputs}\nlimits:").replace("\nsimulator:", TRUTH))
    return rig


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in virtual time on a rig that measures the force of a weight."""
    folder = tmp_path_factory.mktemp("force")
    rig = rig_file(
        folder, f"inputs:\n  spare: {{card: daq, channel: 5, unit: V, span: [0, 1], span_V: [8, 9]}}\n  {LOAD}"
    )
    (folder / "protocol.yaml").write_text(PROTOCOL)
    virtual_run(folder / "protocol.yaml", rig, folder=folder, seed=0)
    return folder


@pytest.fixture
def run(folder: Path) -> Run:
    return runs.open(next(folder.glob("*.h5")))


def test_the_model_carries_the_measured_force_and_no_weight_beside_it(folder: Path, run: Run) -> None:
    tip = run.tip
    np.testing.assert_allclose(tip.force_n[-20:], [[0, 0, WEIGHT_KG * GRAVITY_M_S2]] * 20, atol=0.02)
    assert not tip.weight_g.any()
    config = read(str(folder / "rig.yaml")).config
    pressure = tip.pressure_bar[-1] * 1e5
    arm, load = model_arm(config), TipLoad(config)
    carrying, free = (statics(arm, pressure, load.carrying(kg), doubt_units=False) for kg in (WEIGHT_KG, 0.0))
    np.testing.assert_allclose(1e-3 * tip.model_mm[-1], carrying.tip_m, atol=1e-4)
    assert np.linalg.norm(carrying.tip_m - free.tip_m) > 1e-3
    assert tip.error_mm[-20:].mean() < 0.5, "the simulated arm carries the weight itself"


def test_identification_uses_the_force(run: Run) -> None:
    expected = [0, 0, WEIGHT_KG * GRAVITY_M_S2, 0, 0, 0]
    np.testing.assert_allclose(at_rest(run, settle_s=1.0).wrench[-1], expected, atol=0.02)
    motion = in_motion(run)
    np.testing.assert_allclose(motion.wrench[-1], expected, atol=0.02)
    assert np.isfinite(motion.wrench).all()


def test_a_gap_in_the_force_is_refused_by_identification(run: Run, tmp_path: Path) -> None:
    copy = tmp_path / run.path.name
    shutil.copy(run.path, copy)
    with changed(copy) as file:
        file["entry/tip/force_N"][30] = np.nan
    with pytest.raises(NoDataError, match="tip force is missing"):
        in_motion(runs.open(copy))


def test_a_replay_has_the_same_load(run: Run, tmp_path: Path) -> None:
    again = runs.open(replay(run, tmp_path))
    np.testing.assert_allclose(again.tip.force_n[-1], run.tip.force_n[-1], atol=0.02)
    np.testing.assert_allclose(again.tip.model_mm[-1], run.tip.model_mm[-1], atol=0.05)


def test_a_replay_with_a_force_that_the_run_did_not_measure_is_refused(run: Run, tmp_path: Path) -> None:
    rig = rig_file(tmp_path, f"inputs:\n  {LOAD.replace('load', 'pull')}".replace("load", "pull"))
    rig.write_text(rig.read_text().replace("{load: {rest", "{pull: {rest"))
    with pytest.raises(BadInputError, match="has no input pull"):
        replay(run, tmp_path, rig=str(rig))


def test_a_replay_that_would_lose_the_measured_force_is_refused(run: Run, tmp_path: Path) -> None:
    rig = rig_file(tmp_path, f"inputs:\n  {LOAD.replace(', tip_force_direction: [0, 0, 2]', '')}")
    with pytest.raises(BadInputError, match="whose input load has a tip_force_direction, as in the run"):
        replay(run, tmp_path, rig=str(rig))


def test_without_a_value_of_the_force_the_model_has_no_solution(tmp_path: Path) -> None:
    observer = Observer(load(str(rig_file(tmp_path, f"inputs:\n  {LOAD}", "mock-no-camera"))))
    times, pressures, nothing = np.array([10**9]), np.zeros((1, 3)), FrameSet(0, (), 10**9)
    row = observer.step(nothing, control_cycles(times, pressures, [np.nan]), 0.0)
    assert not row["model_ok"]
    assert np.isnan(row["force_n"]).all()
    later = FrameSet(1, (), 10**9 + 2 * 10**8)
    row = observer.step(later, control_cycles(times + 10**8, pressures, [1.0]), 0.1)
    assert row["model_ok"]
    np.testing.assert_allclose(row["force_n"], [0, 0, 1.0])


@pytest.mark.parametrize(
    ("change", "expected"),
    [({"unit": "kg"}, "N, because"), ({"tip_force_direction": [0, 0, 0]}, "a direction, not three zeros")],
)
def test_a_declaration_that_gives_no_force_is_refused(change: dict[str, object], expected: str) -> None:
    declared = {"card": "daq", "channel": 4, "unit": "N", "span": [0, 10], "tip_force_direction": [0, 0, 1]}
    with pytest.raises(ValueError, match=expected):
        mock_rig(inputs={"load": declared | change})


def test_online_estimation_refuses_a_rig_that_measures_the_force(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status_of("run", "sine-1", "--rig", folder / "rig.yaml", "--fast", "--yes", "--adapt", "--out", folder) == 2
    assert "the estimator does not use input load" in capsys.readouterr().err
