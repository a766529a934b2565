"""Direction of gravity from a load cell: from a foreign table into the archive, the model and the identification."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import model
from calibration.identify import Setup, quasi_static_poses
from calibration.identify.errors import NoDataError
from calibration.identify.prediction.tip_predictor import Predictor
from calibration.identify.unknowns.nuisance import nuisance_parameters
from model.statics import statics
from protocols import BadInputError
from rig.config.arm_model import model_arm
from rig.config.loader import read
from rig.experiment.provenance import quantities
from rig.identify.estimation import rig_uncertainties
from rig.identify.from_archives import open_runs
from rig.identify.initial_setup import initial_rig, recorded_rig
from runs.run import Run
from tests.support.command_line import invoke
from tests.support.import_bench import run_imported, warnings_of
from tests.support.shared_data import shared_data

ROOT = Path(__file__).parents[3]
ARM = Setup(model_arm(read("mock-3").config)).arm
# A base that leans by 0.2 rad, a sensor under it that reads the reaction, 30 degrees about the axis from the arm.
DOWN = Rotation.from_rotvec([0.1, -0.173, 0.0]).apply([0.0, 0.0, 1.0])
CELL = Rotation.from_rotvec([0.0, 0.0, 30.0], degrees=True)
ARM_KG, ZERO_N, NOISE_N = 0.12, np.array([0.4, -0.1, 2.0]), 0.004
HEAD = """\
title: An arm on a base that leans
rig: mock-3
time: {column: t, unit: s}
pressures: {columns: [p1, p2, p3], unit: bar, reading: gauge}
weight: {column: m, unit: g}
tip: {position: {columns: [x, y, z], unit: mm}, uncertainty_mm: 0.05}
"""
GRAVITY = """\
gravity:
  cell: {force: {columns: [fx, fy, fz], unit: N}, axes: rod_base, rotation_deg: [0, 0, 30], reads: reaction}
  rotation_std_deg: 0.5
"""


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight plateaus of an arm under weights, pressed by one chamber; a sensor under the base holds all of it."""
    rng = np.random.default_rng(4)
    leaning = replace(ARM, gravity_m_s2=tuple(9.81 * DOWN))
    rows = ["t,p1,p2,p3,m,x,y,z,fx,fy,fz"]
    for k, weight in enumerate(np.repeat([0.0, 0.1, 0.2, 0.3], 20)):
        bar = 0.2 * (k // 10 % 2)
        force = 9.81 * weight * DOWN
        tip = statics(leaning, np.array([bar * 1e5, 0, 0]), model.Loads(tip_force_n=force)).tip_m
        reading = ZERO_N - CELL.inv().apply((ARM_KG + weight) * 9.81 * DOWN) + rng.normal(0, NOISE_N, 3)
        numbers = [k / 20, bar, 0, 0, 1e3 * weight, *(1e3 * tip), *reading]
        rows.append(",".join(f"{x:.9f}" for x in numbers))
    file = tmp_path_factory.mktemp("leaning") / "leaning.csv"
    file.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def measured(table: Path, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The table with the load cell in its mapping."""
    return run_imported(tmp_path_factory.mktemp("measured"), table, HEAD + GRAVITY)


def angle_deg(one: object, other: object) -> float:
    return math.degrees(math.acos(min(1.0, float(np.dot(np.array(one), np.array(other))))))


def test_the_archive_keeps_the_direction_with_its_uncertainty(measured: Run) -> None:
    gravity = measured.header.measured_gravity
    assert gravity is not None
    assert 0.5 < math.degrees(gravity.uncertainty) < 0.7
    assert angle_deg(gravity.value, DOWN) < 2 * math.degrees(gravity.uncertainty)
    assert "80 rows at rest" in gravity.source
    config = recorded_rig(measured).config
    np.testing.assert_allclose(config.arm.gravity_direction, gravity.value, atol=1e-5)
    assert config.uncertainties.gravity_direction_deg == pytest.approx(math.degrees(gravity.uncertainty), rel=1e-4)
    assert [file.kind for file in measured.header.calibrations] == ["gravity"]
    assert "gravity_direction: [0" not in measured.header.rig_yaml


def test_the_model_of_the_archive_predicts_the_tips_of_the_leaning_arm(measured: Run) -> None:
    poses = quasi_static_poses(measured)
    rest = np.arange(len(poses)) % 10 > 4
    error = Predictor(poses)(Setup(model_arm(recorded_rig(measured).config))) - poses.tip_m
    blind = Predictor(poses)(Setup(ARM)) - poses.tip_m
    assert np.linalg.norm(error[rest], axis=1).max() < 0.1 * np.linalg.norm(blind[rest], axis=1).max()


def test_identification_estimates_gravity_with_the_measured_uncertainty(measured: Run) -> None:
    config = recorded_rig(measured).config
    setup = Setup(model_arm(config))
    names = {one.name for one in nuisance_parameters(setup, [quasi_static_poses(measured)], ())}
    assert {"gravity_rx_rad", "gravity_ry_rad"} <= names
    gravity = measured.header.measured_gravity
    assert gravity is not None
    prior = rig_uncertainties(config, setup)["gravity_rx_rad"]
    assert prior.mean == 0
    assert prior.std == pytest.approx(gravity.uncertainty, rel=1e-4)


def test_a_rig_named_for_the_start_takes_the_measured_direction(measured: Run) -> None:
    gravity = measured.header.measured_gravity
    assert gravity is not None
    rig = initial_rig(measured, "mock-3")
    np.testing.assert_allclose(rig.config.arm.gravity_direction, gravity.value, atol=1e-5)


def test_rig_show_states_the_measured_direction(measured: Run) -> None:
    shown = invoke("show", measured.path)
    assert shown.exit_code == 0
    (line,) = [line for line in shown.output.splitlines() if line.startswith("gravity")]
    assert "+- 0.5 degrees" in line or "+- 0.6 degrees" in line


def test_a_known_zero_gives_the_direction_without_weights(table: Path, tmp_path: Path) -> None:
    zero = ", ".join(f"{x:g}" for x in ZERO_N)
    mapping = HEAD + GRAVITY + f"  at_rest_s: [[0, 0.95]]\n  zero_N: [{zero}]\n  zero_std_N: 0.02\n"
    gravity = run_imported(tmp_path, table, mapping).header.measured_gravity
    assert gravity is not None
    # 0.02 N across 0.12 kg x 9.81 m/s^2 is 0.97 degrees.
    assert math.degrees(gravity.uncertainty) == pytest.approx(math.hypot(0.5, 0.97), abs=0.15)
    assert angle_deg(gravity.value, DOWN) < 1
    assert "20 rows at rest" in gravity.source


def test_a_wrong_sign_or_unit_is_imported_with_a_warning(table: Path, tmp_path: Path) -> None:
    mapping = HEAD + GRAVITY.replace("reaction", "weight").replace("unit: N", "unit: mN")
    said = warnings_of(run_imported(tmp_path, table, mapping))
    assert "against the rig's gravity_direction, [0, 0, 1]: does it read weight or reaction" in said
    assert "1 kg more on the arm changes the force of the load cell by 0.0098 N, not by 9.81 N" in said


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("rotation_std_deg: 0.5", "at_rest_s: [[0, 0.95]]", 8, "tell weight from zero"),
        ("rotation_std_deg: 0.5", "at_rest_s: [[90, 99]]", 8, "0 readings at rest, 20 or more"),
        ("rotation_std_deg: 0.5", "at_rest_s: [[3, 2]]", 9, "begin and end of a time"),
        ("rotation_std_deg: 0.5", "at_rest_s: []", 9, "at_rest_s"),
        ("rotation_std_deg: 0.5", "rotation_std_deg: 0", 9, "above 0"),
        ("rotation_std_deg: 0.5", "zero_N: [0, 0, 0]", 7, "zero_std_N"),
        ("rotation_std_deg: 0.5", "zero_std_N: 0.1", 7, "zero_N"),
        ("reads: reaction", "reads: force", 8, "weight"),
        (", reads: reaction", "", 8, "reads"),
        ("axes: rod_base", "axes: tip", 8, "an orientation of the tip"),
        ("[fx, fy, fz]", "[fx, fy, m]", 8, "already used"),
        ("[fx, fy, fz]", "[fx, fy, fw]", 0, "fw"),
        ("rig: mock-3\n", "", 7, "a rig beside it"),
        (GRAVITY.splitlines()[1], "", 7, "a wrench whose cell it is"),
    ],
)
def test_a_cell_that_cannot_show_gravity_is_refused_with_its_line(
    table: Path, tmp_path: Path, old: str, new: str, line: int, said: str
) -> None:
    text = HEAD + GRAVITY
    assert old in text
    with pytest.raises(BadInputError, match=r"mapping\.yaml|leaning\.csv") as bad:
        run_imported(tmp_path, table, text.replace(old, new))
    assert said in str(bad.value)
    assert line in {problem.line for problem in bad.value.problems} or line == 0


def test_runs_with_different_directions_are_not_identified_together(measured: Run, table: Path, tmp_path: Path) -> None:
    alone = run_imported(tmp_path, table, HEAD)
    assert any("counts for all runs" in note for note in open_runs([measured.path, alone.path], one_arm=True).notes)
    turned = run_imported(tmp_path, table, HEAD + GRAVITY.replace("[0, 0, 30]", "[0, 0, 60]"))
    with pytest.raises(NoDataError, match="degrees apart"):
        open_runs([measured.path, turned.path], one_arm=True)


def test_a_run_of_the_bench_has_no_measured_direction(measured: Run) -> None:
    header = replace(measured.header, quantities=quantities(recorded_rig(measured).config))
    assert header.measured_gravity is None


def test_the_load_cell_of_the_real_arm_shows_that_it_hangs(tmp_path: Path) -> None:
    """Nothing else in these data says which way is down; the cell carries a few grams, turned by 60 degrees."""
    example = (ROOT / "docs" / "examples" / "stiff-flop-loaded.yaml").read_text(encoding="utf-8")
    reference = (ROOT / "docs" / "reference" / "import-mapping.md").read_text(encoding="utf-8")
    (between_pushes,) = [line for line in reference.splitlines() if line.startswith("gravity: {at_rest_s:")]
    rig = ROOT / "docs" / "examples" / "stiff-flop-arm.yaml"
    text = example.replace("rig: stiff-flop-arm.yaml", f"rig: {rig}") + between_pushes + "\n"
    run = run_imported(tmp_path, shared_data("stiff_flop", "Load1.mat"), text)
    gravity = run.header.measured_gravity
    assert gravity is not None
    assert angle_deg(gravity.value, [0, 0, 1]) < 10
    assert math.degrees(gravity.uncertainty) < 5
