"""Overlays of a rig file are merged and the whole is validated once; each fault is found in the file that states it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calibration.identify import Setup, identify
from calibration.identify.presentation.parameters_document import write as write_parameters
from calibration.identify.simulated_experiments import perform, plan
from protocols import BadInputError, document
from rig.config import loader, parameters_overlay
from rig.config.arm_model import model_arm
from rig.config.calibration_files import write
from rig.config.schema import RigConfig
from rig.experiment import run as experiment
from rig.experiment.options import RunOptions
from rig.experiment.prepare import prepare
from tests.rig.config.test_calibration_files import camera_file, tool_file


@pytest.fixture(scope="module")
def parameters(tmp_path_factory: pytest.TempPathFactory) -> Path:
    start = Setup(model_arm(loader.load("mock")))
    data = [perform(plan("a", np.linspace(0, 0.6e5, 7)[:, None] * np.eye(3)[0]), start, np.random.default_rng(3))]
    fit = identify(data, start, ["rpe_per_bar"])
    return write_parameters(fit, tmp_path_factory.mktemp("found") / "arm.yaml")


@pytest.fixture
def calibrated(tmp_path: Path) -> Path:
    """A rig file that names two calibrations."""
    write(camera_file(), tmp_path / "c.yaml")
    write(tool_file(), tmp_path / "t.yaml")
    file = tmp_path / "my.yaml"
    file.write_text(loader.text("mock").replace("name: mock\n", "name: mock\ncalibrations: [c.yaml, t.yaml]\n"))
    return file


@pytest.fixture
def validations(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The file of each validation of a whole rig."""
    found: list[str] = []
    plain = document.validate

    def counting(kind: type, source: document.Document, *more: object) -> object:
        if kind is RigConfig:
            found.append(source.file)
        return plain(kind, source, *more)  # type: ignore[arg-type]

    monkeypatch.setattr(document, "validate", counting)
    return found


def test_a_rig_with_calibrations_and_parameters_is_validated_once(
    calibrated: Path, parameters: Path, validations: list[str]
) -> None:
    config = loader.read(calibrated, parameters_overlay.read(parameters)).config
    assert len(validations) == 1
    assert config.cameras["front"].lens.fx_px == 621.5
    assert config.arm.material.rpe_per_bar == pytest.approx(
        parameters_overlay.read(parameters).found.arm.material.rpe_per_bar
    )


def test_a_request_of_a_run_validates_its_rig_once(
    calibrated: Path, parameters: Path, validations: list[str], tmp_path: Path
) -> None:
    prepared = prepare("ramp-a", str(calibrated), RunOptions(out=tmp_path, fast=True, parameters=parameters))
    assert len(validations) == 1
    assert [file.name for file in prepared.rig.calibrations] == ["c.yaml", "t.yaml"]
    assert prepared.rig.parameters == parameters.read_text()


def test_an_archived_rig_with_its_overlays_is_validated_once_and_is_the_same(
    calibrated: Path, parameters: Path, validations: list[str], tmp_path: Path
) -> None:
    prepared = prepare("ramp-a", str(calibrated), RunOptions(out=tmp_path, fast=True, parameters=parameters))
    about = experiment.header(prepared, 0)
    validations.clear()
    assert loader.recorded(about, tmp_path / "run.h5").config == prepared.config
    assert len(validations) == 1


def test_a_value_that_an_overlay_brings_is_refused_at_its_line_of_that_file(tmp_path: Path, parameters: Path) -> None:
    """An identified cap mass that no arm has, and a mistake in the rig file: both in one message."""
    text = parameters.read_text()
    start = text.index("cap_mass_g: ")
    wrong = text[:start] + "cap_mass_g: 1.0e9" + text[text.index("\n", start) :]
    (tmp_path / "arm.yaml").write_text(wrong)
    (tmp_path / "my.yaml").write_text(loader.text("mock").replace("stale_s: 0.1", "stale_s: -1"))
    with pytest.raises(BadInputError) as bad:
        loader.read(tmp_path / "my.yaml", parameters_overlay.read(tmp_path / "arm.yaml"))
    places = {problem.where: (Path(problem.file).name, problem.line) for problem in bad.value.problems}
    line = wrong[: wrong.index("cap_mass_g: 1.0e9")].count("\n") + 1
    assert places.get("arm, cap_mass_g") == ("arm.yaml", line)
    assert places["limits, stale_s"][0] == "my.yaml"


def test_a_calibration_of_another_camera_and_a_mistake_in_the_rig_file_are_both_reported(calibrated: Path) -> None:
    calibrated.write_text(
        calibrated.read_text().replace("width_px: 640", "width_px: 800").replace("rate_hz: 200", "rate_hz: -1")
    )
    with pytest.raises(BadInputError) as bad:
        loader.read(calibrated)
    assert {Path(problem.file).name for problem in bad.value.problems} == {"my.yaml", "c.yaml", "t.yaml"}


def test_a_missing_calibration_does_not_hide_the_mistakes_of_the_rig_file(calibrated: Path) -> None:
    calibrated.write_text(calibrated.read_text().replace("c.yaml", "gone.yaml").replace("rate_hz: 200", "rate_hz: -1"))
    with pytest.raises(BadInputError) as bad:
        loader.read(calibrated)
    assert "gone.yaml" in str(bad.value)
    assert "control, rate_hz" in str(bad.value)


def test_the_yaml_of_a_rig_with_its_overlays_is_a_rig_file(calibrated: Path, parameters: Path) -> None:
    rig = loader.read(calibrated, parameters_overlay.read(parameters))
    assert loader.parse(rig.yaml, "both.yaml") == rig.config
