"""The errors of measurement that a design takes from a run are those of its archive."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import protocols
from calibration.design.information import error_bars
from calibration.identify.observations.data import at_rest, in_motion
from calibration.identify.simulated_experiments import MeasurementErrors
from rig.config.loader import load
from rig.design.design import unknowns_of
from rig.design.expected_poses import errors_of_run, errors_text, expected_poses
from runs.run import Run
from tests.support.command_line import status_of
from tests.support.sectioned_bench import sectioned_rig
from tests.support.virtual_runs import virtual_run

pytestmark = pytest.mark.slow

STEPS = """title: levels
steps:
  - {hold: {actuators: [1, 2, 3], level_bar: 0.1, duration_s: 2.5}}
  - {ramp: {actuators: [2, 3], to_bar: 0.5, duration_s: 0.5}}
  - {hold: {duration_s: 2.5}}
"""


@pytest.fixture(scope="module")
def protocol(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("measured") / "levels.yaml"
    file.write_text(STEPS)
    return file


@pytest.fixture(scope="module")
def run(protocol: Path) -> Run:
    return virtual_run(protocol, folder=protocol.parent, seed=4)


def test_errors_are_those_that_an_identification_reads_from_the_run(run: Run) -> None:
    found, frames, plateaus = errors_of_run(run), in_motion(run), at_rest(run)
    tip_m = np.sqrt(np.diagonal(frames.covariance_m2[frames.has_tip], axis1=1, axis2=2))
    assert (tip_m.min(axis=0) <= found.tip_m).all()
    assert (tip_m.max(axis=0) >= found.tip_m).all()
    assert found.pressure_pa == np.median(frames.pressure_std_pa)
    assert found.plateau_pa == np.median(plateaus.pressure_std_pa)
    assert found.plateau_pa < found.pressure_pa
    assert frames.orientation is not None
    assert found.rotation_rad is not None
    assert 0 < found.rotation_rad < 2 * np.sqrt(np.nanmax(frames.orientation.covariance_rad2))


def test_the_expected_poses_of_a_rig_with_boards_along_the_arm_have_them(protocol: Path) -> None:
    config = sectioned_rig()
    trajectory = protocols.load(str(protocol)).expand(config.actuators)
    planned = expected_poses("levels", trajectory, config, MeasurementErrors(rotation_rad=0.01))
    assert [(one.name, one.at_m) for one in planned.sections] == [("middle", 0.085), ("lower", 0.125)]
    for one in planned.sections:
        # A plateau is a mean of many frames.
        assert (one.covariance_m2[:, 0, 0] < 0.5 * MeasurementErrors().section_m[0] ** 2).all()
        np.testing.assert_allclose(one.covariance_m2, planned.covariance_m2)
    tip, free = replace(planned, sections=()), ("law", "base")
    bars, without = (error_bars([one], unknowns_of(config, free, [one])) for one in (planned, tip))
    narrowed = bars.std / without.std
    assert (narrowed < 1.05).all()
    assert narrowed[bars.names.index("base_z_m")] < 0.8
    assert "sections middle, lower 0.2, 0.4, 0.2 mm" in errors_text(MeasurementErrors(), tuple(config.sections))


def test_a_design_with_the_errors_of_a_run_says_which(
    run: Run, protocol: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.design.design.LIBRARY", (str(protocol),))
    file, config = tmp_path / "design.yaml", load("mock")
    words = ["design", "--rig", "mock", "--duration-s", "8", "--free", "law", "--errors-of", str(run.path)]
    assert status_of(*words, "--to", file, "--json") == 0
    found, errors = json.loads(capsys.readouterr().out), errors_of_run(run)
    assert found["errors"]["source"] == str(run.path)
    assert tuple(found["errors"]["tip_m"]) == errors.tip_m
    assert "# Standard deviations: tips " in file.read_text()
    usual = expected_poses("design", protocols.load(str(file)).expand(config.actuators), config, MeasurementErrors())
    coarse = error_bars([usual], unknowns_of(config, ("law",), [usual]))
    finer = [found["parameters"][name]["std"] for name in coarse.names]
    assert (np.array(finer) < coarse.std).all()
