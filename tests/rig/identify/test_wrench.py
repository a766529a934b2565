"""A measured wrench at the tip: from a foreign table through its mapping into the archive, and into the prediction."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import model
from calibration.identify import Setup, identify, quasi_static_poses
from calibration.identify.prediction.tip_predictor import Predictor
from model import sensitivities
from model.arrays import Array
from model.statics import statics
from model.variation import TipWrench
from protocols import BadInputError
from tests.support.import_bench import run_imported, warnings_of

TRUTH = Setup(
    model.Arm.paper(),
    base_translation_m=(0.004, -0.002, 0.003),
    base_rotation_rad=(0.02, -0.03, 0.1),
    tool_offset_m=(0.015, 0.0, 0.02),
)
AT_M = np.array([0.0, 0.005, 0.01])
HEAD = """
title: An arm that is pulled at its tip
file: {delimiter: comma}
time: {column: t, unit: s}
pressures: {columns: [p1, p2, p3], unit: bar, reading: gauge}
tip:
  position: {columns: [x, y, z], unit: mm}
  orientation: {columns: [qw, qx, qy, qz], order: wxyz}
  uncertainty_mm: 0.05
"""
TRACKER = """wrench:
  force: {columns: [fx, fy, fz], unit: N}
  moment: {columns: [mx, my, mz], unit: N mm}
  axes: tracker
"""
TIP = """wrench:
  force: {columns: [gx, gy, gz], unit: N}
  moment: {columns: [hx, hy, hz], unit: N mm}
  axes: tip
  on: surroundings
  at_mm: [0, 5, 10]
"""
# A load cell that stands askew on the tip sensor, so that its axes are the tracker's while nothing pulls.
CELL = """wrench:
  force: {columns: [cx, cy, cz], unit: N}
  moment: {columns: [dx, dy, dz], unit: N mm}
  axes: tip
  aligned_rows: 4
  zero_rows: 4
"""
ZERO_N, ZERO_N_M = np.array([0.3, -0.2, 1.0]), np.array([2e-3, 0.0, -1e-3])


def pulled(pressure: Array, force: Array, moment: Array) -> tuple[Array, Array]:
    """Measured point and orientation [tracker] of the true arm under a wrench at that point [tracker]."""
    turn = Rotation.from_rotvec(TRUTH.base_rotation_rad)
    f, m, tool = turn.inv().apply(force), turn.inv().apply(moment), np.array(TRUTH.tool_offset_m)
    rotation = np.eye(3)
    for _ in range(30):
        lever = np.cross(rotation @ tool, f)
        shape = statics(TRUTH.arm, pressure, model.Loads(tip_force_n=f, tip_moment_n_m=m + lever))
        rotation = shape.tip_rotation
    return TRUTH.measured(shape.tip_m[None], rotation[None])[0], (turn * Rotation.from_matrix(rotation)).as_matrix()


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(8)
    names = ["t", "p1", "p2", "p3", "x", "y", "z", "qw", "qx", "qy", "qz"]
    names += [a + b for a in "fmghcd" for b in "xyz"]
    rows = [",".join(names)]
    straight = pulled(np.zeros(3), np.zeros(3), np.zeros(3))[1]
    for k in range(40):
        going = max(k - 4, 0)
        bar = np.array([0.5 * np.sin(going / 13) ** 2, 0.3 * np.sin(going / 17) ** 2, 0.0])
        force, moment = rng.uniform(-1, 1, 3) * bool(going), rng.uniform(-0.01, 0.01, 3) * bool(going)
        tip, rotation = pulled(bar * 1e5, force, moment)
        # The same wrench as a load cell on the tip says it: what the arm does to it, elsewhere, along its own axes.
        own_force = -rotation.T @ force
        own_moment = -rotation.T @ moment - np.cross(AT_M, own_force)
        back = straight @ rotation.T
        q = Rotation.from_matrix(rotation).as_quat()[[3, 0, 1, 2]]
        numbers = [k / 20, *bar, *(1e3 * tip), *q, *force, *(1e3 * moment), *own_force, *(1e3 * own_moment)]
        numbers += [*(back @ force + ZERO_N), *(1e3 * (back @ moment + ZERO_N_M))]
        rows.append(",".join(f"{x:.9f}" for x in numbers))
    file = tmp_path_factory.mktemp("pulled") / "pulled.csv"
    file.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return file


def turned_as(straight: Array) -> str:
    """How the load cell stands on the tip sensor, as a mapping says it."""
    x, y, z = np.degrees(Rotation.from_matrix(straight).inv().as_rotvec())
    return f"rotation_deg: [{x:.7f}, {y:.7f}, {z:.7f}]"


STATED = CELL.replace("aligned_rows: 4", turned_as(pulled(np.zeros(3), np.zeros(3), np.zeros(3))[1]))


@pytest.mark.parametrize("wrench", [TRACKER, TIP, CELL, STATED])
def test_the_wrench_of_any_stated_frame_predicts_the_tip(table: Path, tmp_path: Path, wrench: str) -> None:
    poses = quasi_static_poses(run_imported(tmp_path, table, HEAD + wrench))
    assert len(poses) == 40
    error = np.linalg.norm(Predictor(poses)(TRUTH) - poses.tip_m, axis=1)
    # A tenth of a millimetre: the pressures of the table are smoothed, as those of every run are.
    assert error.max() < 1e-4
    blind = replace(poses, wrench=np.zeros((40, 6)))
    assert np.linalg.norm(Predictor(blind)(TRUTH) - poses.tip_m, axis=1).mean() > 5e-3


def test_a_strong_force_off_the_axis_is_solved_or_reported_as_unsolved() -> None:
    """The lever of such a pull turns more than the arm that it turns: going back and forth between them diverges."""
    geometry = model.Geometry.on_circle(0.045, 0.00395, 0.0069, 0.00797, (90.0, -30.0, 210.0))
    material = model.Material(130e3, 0.0494, 0.0243, 0.0, 0.333)
    arm = model.Arm((model.Segment(geometry, material),), cap_mass_kg=0.013)
    n, point, rng = 24, np.array([0.0157, 0.0, 0.006]), np.random.default_rng(1)
    pressure_pa = rng.uniform(0, 1e5, (n, 3)) * np.eye(3)[rng.integers(0, 3, n)]
    force = 2.0 * Rotation.random(n, random_state=3).apply([0, 0, 1])
    found = sensitivities.statics(arm, pressure_pa, (), np.zeros(n), TipWrench(force, np.zeros((n, 3)), point))
    met = np.flatnonzero(found.ok)
    assert len(met) > 0.8 * n
    assert np.isnan(found.tip_m[~found.ok]).all()
    for k in met:
        loads = model.Loads(tip_force_n=force[k], tip_moment_n_m=np.cross(found.tip_rotation[k] @ point, force[k]))
        np.testing.assert_allclose(statics(arm, pressure_pa[k], loads).tip_m, found.tip_m[k], atol=1e-6)


def test_an_arm_under_load_determines_its_law_without_free_pressures(table: Path, tmp_path: Path) -> None:
    poses = quasi_static_poses(run_imported(tmp_path, table, HEAD + TRACKER))
    material = replace(TRUTH.arm.material, a1_per_n=0.0065)
    fit = identify([poses], replace(TRUTH, arm=TRUTH.arm.with_segment(material=material)), ["a1_per_n"])
    found = fit["a1_per_n"]
    assert found.value == pytest.approx(TRUTH.arm.material.a1_per_n, rel=2e-3)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("axes: tip", "axes: world", "tracker"),
        ("unit: N mm", "unit: lb", "N mm"),
        ("unit: N}", "unit: kg}", "mN"),
        ("axes: tip", "axes: tracker\n  aligned_rows: 4", "only a cell on the tip turns"),
        ("axes: tip", "axes: tip\n  aligned_rows: 4\n  rotation_deg: [0, 0, 1]", "not both"),
        ("axes: tip", "axes: tip\n  zero_rows: 50", "50"),
        ("[gx, gy, gz]", "[gx, gy]", "force"),
        ("[gx, gy, gz]", "[gx, gy, p1]", "already used"),
        ("  orientation: {columns: [qw, qx, qy, qz], order: wxyz}\n", "", "orientation"),
    ],
)
def test_a_wrench_without_a_known_frame_is_refused(table: Path, tmp_path: Path, old: str, new: str, said: str) -> None:
    text = HEAD + TIP
    assert old in text
    with pytest.raises(BadInputError, match=r"mapping\.yaml|pulled\.csv") as bad:
        run_imported(tmp_path, table, text.replace(old, new))
    assert said in str(bad.value)


def test_a_wrench_that_is_doubtful_is_imported_with_a_warning(table: Path, tmp_path: Path) -> None:
    said = warnings_of(run_imported(tmp_path, table, HEAD + CELL.replace("N mm", "N m").replace("rows: 4", "rows: 20")))
    assert "are their units right?" in said
    assert "whose mean is used as the no-load reading" in said
    assert "degrees within the first 20 rows" in said
    assert warnings_of(run_imported(tmp_path, table, HEAD + CELL)).count("\n") == 0
