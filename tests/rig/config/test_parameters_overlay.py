"""A file of identified parameters: run, replay and simulate take it as it is, or say what is wrong with it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

import runs
import tests.support.synthetic_runs as made_up
from calibration.identify import Setup, identify
from calibration.identify.fitting.results import SectionFit
from calibration.identify.presentation.parameters_document import section_facts, write
from calibration.identify.simulated_experiments import perform, plan
from model.statics import statics
from protocols import BadInputError
from rig.config import loader
from rig.config.arm_model import model_arm, true_arm
from rig.config.loader import load, recorded, text
from rig.config.optics import rigid
from rig.config.parameters_overlay import read
from rig.experiment.replay import replay_rig
from runs.archive.writer import finalise
from runs.journal.journal import JournalWriter
from runs.records import DetectionStatus, RunFooter, Status
from runs.run import Run
from tests.rig.config.test_calibration_files import dlt_file
from tests.support.budget import examples
from tests.support.command_line import status_of

PROTOCOL = """title: A level
steps:
  - ramp: {actuators: [1], to_bar: 0.3, duration_s: 0.5}
  - hold: {duration_s: 0.5}
"""
SHIFT_M, TURN_RAD = (2e-3, -1e-3, 3e-3), (0.01, 0.0, 0.02)


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `rig identify` writes of an arm that is softer, longer, and mounted elsewhere than the mock's file says."""
    start = Setup(model_arm(load("mock")))
    material = replace(start.arm.material, a1_per_n=0.0079, rpe_per_bar=0.049)
    geometry = replace(start.arm.geometry, length_m=0.175)
    arm = replace(start.arm, cap_mass_kg=0.056).with_segment(material=material, geometry=geometry)
    truth = Setup(arm, base_translation_m=SHIFT_M, base_rotation_rad=TURN_RAD, sensor_gain=(1.02, 1.0, 1.0))
    ramp = np.linspace(0.0, 0.6e5, 7)[:, None]
    planned = [plan("a", ramp * np.array([1.0, 0, 0])), plan("b", ramp * np.array([0, 1.0, 1.0]))]
    data = [perform(one, truth, np.random.default_rng(3)) for one in planned]
    fit = identify(
        data, replace(truth, arm=start.arm, sensor_gain=()), ["law", "rpe_per_bar", "length_m", "cap_mass_kg"]
    )
    return write(replace(fit, setup=truth), tmp_path_factory.mktemp("found") / "arm.yaml")


def rig(*arguments: str, status: int = 0) -> None:
    assert status_of(*arguments) == status


def newest(folder: Path) -> Run:
    return runs.open(max(folder.glob("*.h5"), key=lambda path: path.stat().st_mtime_ns))


def protocol(folder: Path) -> str:
    file = folder / "level.yaml"
    file.write_text(PROTOCOL, encoding="utf-8")
    return str(file)


def test_simulate_applies_the_overlay_and_records_it_verbatim(found: Path, tmp_path: Path) -> None:
    still = text("mock") + "model: {mode: static}\n"
    (tmp_path / "still.yaml").write_text(still, encoding="utf-8")
    options = ["--rig", str(tmp_path / "still.yaml"), "--parameters", str(found), "--out", str(tmp_path)]
    rig("simulate", protocol(tmp_path), *options)
    run = newest(tmp_path)
    assert run.header.parameters_yaml == found.read_text()
    assert run.header.rig_yaml == still
    arm = model_arm(recorded(run.header, run.path).config)
    assert arm.material.a1_per_n == 0.0079
    expected = 1e3 * statics(arm, [0.3e5, 0, 0]).tip_m
    assert run.tip.model_mm[-1] == pytest.approx(expected, abs=1e-6)
    assert np.linalg.norm(expected - 1e3 * statics(model_arm(load("mock")), [0.3e5, 0, 0]).tip_m) > 5


@pytest.mark.slow
def test_run_and_replay_measure_from_the_identified_base_and_do_not_change_the_simulated_arm(
    found: Path, tmp_path: Path
) -> None:
    with_it, without = tmp_path / "with", tmp_path / "without"
    common = ("run", protocol(tmp_path), "--fast", "--yes", "--no-report", "--seed", "4")
    rig(*common, "--out", str(without))
    rig(*common, "--out", str(with_it), "--parameters", str(found))
    plain, laid = newest(without), newest(with_it)
    rig("replay", str(plain.path), "--parameters", str(found), "--out", str(tmp_path))
    again = newest(tmp_path)
    placed = Setup(model_arm(load("mock")), base_translation_m=SHIFT_M, base_rotation_rad=TURN_RAD)
    for run in (laid, again):
        assert run.header.parameters_yaml == found.read_text()
        seen = run.tip.seen == DetectionStatus.MEASURED
        there = np.isin(plain.tip.frame, run.tip.frame[seen])
        back = 1e3 * placed.measured(run.tip.measured_mm[seen] / 1e3, np.zeros((seen.sum(), 3, 3)))
        assert back == pytest.approx(plain.tip.measured_mm[there], abs=1.0)  # the gain of sensor 1 moves the arm, too
    assert laid.simulated is not None
    assert laid.simulated.tip_mm == pytest.approx(laid.tip.measured_mm, abs=3.0)
    true, still = true_arm(load("mock")), true_arm(recorded(laid.header, laid.path).config)
    assert still == true


def test_calibrations_of_a_replay_lie_under_the_parameters_as_in_a_rigs_file(found: Path, tmp_path: Path) -> None:
    newer = tmp_path / "newer.yaml"
    newer.write_text(
        found.read_text().replace("base_translation_mm: [2.0, -1.0, 3.0]", "base_translation_mm: [0, 5, 0]")
    )
    assert newer.read_text() != found.read_text()
    calibration = dlt_file(tmp_path)
    about = replace(made_up.header(), rig_yaml=text("mock"), parameters_yaml=found.read_text())
    journal = JournalWriter(tmp_path / "run.mcap", about)
    journal.close(RunFooter(made_up.START_NS, Status.FINISHED, ""))
    run = runs.open(finalise(journal.path))
    under = loader.read("mock").calibrated([calibration])
    for newly, laid in ((None, found), (newer, newer)):
        bench, _ = replay_rig(run, parameters=newly, calibrations=[calibration])
        assert bench.parameters == laid.read_text()
        expected = under.identified(read(laid)).config
        assert bench.config.arm == expected.arm
        for one, other in zip(bench.config.sensors, expected.sensors, strict=True):
            assert one.span_bar == pytest.approx(other.span_bar)
        stands, should = (rigid(config.cameras["front"].placement) for config in (bench.config, expected))
        assert stands.translation_m == pytest.approx(should.translation_m, abs=1e-9)
        assert stands.rotation == pytest.approx(should.rotation, abs=1e-9)
        built, as_it_was = true_arm(bench.config), true_arm(expected)
        assert built == as_it_was


def test_identified_values_are_found_in_the_rig(found: Path) -> None:
    config = loader.read("mock").identified(read(found)).config
    assert config.arm.geometry.length_mm == pytest.approx(175.0)
    assert config.arm.cap_mass_g == pytest.approx(56.0)
    # The reading of a sensor that is 2 % too large at 1 bar is corrected.
    sensor = next(s for s in config.sensors if s.actuator == 1)
    plain = next(s for s in load("mock").sensors if s.actuator == 1)
    volts = np.array([1.0])
    assert sensor.pressure_pa(volts) * 1.02 == pytest.approx(plain.pressure_pa(volts))


def test_parameters_from_a_run_with_measured_sections_apply(found: Path, tmp_path: Path) -> None:
    document = yaml.safe_load(found.read_text())
    document["data"][0]["sections"] = [section_facts(SectionFit("middle", 0.08, 30, 12, 1e-4, 2e-3))]
    file = tmp_path / "sections.yaml"
    file.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    assert loader.read("mock").identified(read(file)).config == loader.read("mock").identified(read(found)).config


def refusal(found: Path, changed: dict[str, object], folder: Path, **rig_changes: str) -> str:
    data = yaml.safe_load(found.read_text())
    data.update(changed)
    file = folder / "changed.yaml"
    file.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    own = text("mock")
    for old, new in rig_changes.items():
        assert own.count(f"{old}: ") >= 1
        start = own.index(f"{old}: ")
        own = own[:start] + f"{old}: {new}" + own[own.index("\n", start) :]
    (folder / "rig.yaml").write_text(own, encoding="utf-8")
    with pytest.raises(BadInputError) as bad:
        loader.read(folder / "rig.yaml").identified(read(file))
    return str(bad.value)


def test_parameters_of_another_arm_are_refused_by_file_and_line(found: Path, tmp_path: Path) -> None:
    said = refusal(found, {}, tmp_path, length_mm="150.0", circle_radius_mm="20.0")
    assert "changed.yaml:" in said
    assert "length_mm" in said
    assert "another arm" in said
    assert "circle_radius_mm" in said


def test_parameters_of_another_model_are_refused(
    found: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ("simulate", protocol(tmp_path), "--parameters", str(found), "--out", str(tmp_path))
    rig(*command, "--model", "homogeneous", status=2)
    said = capsys.readouterr().err
    assert "arm.yaml:" in said
    assert "inhomogeneous+rpe" in said
    assert "homogeneous, the model that --model names" in said


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"softrig_parameters": 1}, "2"),
        ({"arm": {"cap_mass_g": -1}}, "geometry"),
        ({"surplus": 3}, "surplus"),
        ({"covariance": [[1.0]]}, "rows"),
        ({"sensing": {"gain": [0.0, 1.0, 1.0], "lag_s": 0}}, "gain"),
    ],
)
def test_malformed_values_are_reported_with_file_and_line(
    found: Path, tmp_path: Path, change: dict[str, object], said: str
) -> None:
    message = refusal(found, change, tmp_path)
    assert "changed.yaml:" in message
    assert said in message


@examples(40, HealthCheck.function_scoped_fixture)
@given(st.text(max_size=60))
def test_any_other_text_is_refused_in_words(tmp_path: Path, anything: str) -> None:
    file = tmp_path / "any.yaml"
    file.write_text(anything, encoding="utf-8")
    with pytest.raises(BadInputError, match=r"any\.yaml"):
        read(file)
