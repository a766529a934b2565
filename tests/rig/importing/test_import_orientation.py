"""Orientations in every way that trackers write them place the tool centre point alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import runs
from protocols import BadInputError
from rig.importing import import_table
from runs.columns import Tip

TURNS = Rotation.from_euler("ZYX", [[0, 0, 0], [30, -20, 10], [80, 15, -40]], degrees=True)
OFFSET_MM = np.array([0.0, 0.0, 30.0])


def imported(folder: Path, values: np.ndarray, order: str) -> np.ndarray:  # type: ignore[type-arg]
    names = [f"q{k}" for k in range(values.shape[1])]
    lines = [",".join(("t", "p", "x", "y", "z", *names))]
    lines += [",".join(map(repr, (0.1 * i, 0.5, 1.0, 2.0, 3.0, *row))) for i, row in enumerate(values.tolist())]
    (folder / "data.csv").write_text("\n".join(lines))
    (folder / "mapping.yaml").write_text(
        "title: Turned\ntime: {column: t, unit: s}\npressures: {columns: [p], unit: bar, reading: gauge}\n"
        "tip:\n  position: {columns: [x, y, z], unit: mm}\n  offset_mm: [0, 0, 30]\n"
        f"  orientation: {{columns: [{', '.join(names)}], order: {order}}}\n"
    )
    made = import_table(folder / "data.csv", folder / "mapping.yaml", folder / "out", "", "")
    return runs.open(made.archive).tip.measured_mm


@pytest.mark.parametrize(
    ("values", "order"),
    [
        (TURNS.as_quat(), "xyzw"),
        (TURNS.as_matrix().reshape(-1, 9), "matrix"),
        (TURNS.as_rotvec(), "vector, unit: rad"),
        (TURNS.as_euler("ZYX", degrees=True), "ZYX, unit: deg"),
        (TURNS.as_euler("xyz"), "xyz, unit: rad"),
    ],
)
def test_every_way_to_write_a_rotation_gives_the_same_tip(tmp_path: Path, values: np.ndarray, order: str) -> None:  # type: ignore[type-arg]
    np.testing.assert_allclose(
        imported(tmp_path, values, order), np.array([1, 2, 3]) + TURNS.apply(OFFSET_MM), atol=1e-9
    )


@pytest.mark.parametrize(
    ("values", "order", "said"),
    [
        (np.ones((2, 9)), "matrix", "no rotation"),
        (np.ones((2, 3)), "XYZ", "deg or rad"),
        (np.ones((2, 3)), "matrix", "9 columns"),
        (np.ones((2, 3)), "xxy, unit: deg", "Euler axes"),
    ],
)
def test_an_invalid_rotation_is_refused(tmp_path: Path, values: np.ndarray, order: str, said: str) -> None:  # type: ignore[type-arg]
    with pytest.raises(BadInputError, match=said):
        imported(tmp_path, values, order)


FRAME = "frame: {rotation_deg: [0, 0, 30], rotation_std_deg: 0.3}\n"


def kept(folder: Path, turns: Rotation, keys: str, rest: str = "", offset: str = "") -> Tip:
    """The imported tips of a sensor with these orientations, 0.1, 0.2 and 0.3 m above the base."""
    lines = ["t,p,x,y,z,w,i,j,k"]
    for n, q in enumerate(turns.as_quat()[:, [3, 0, 1, 2]].tolist()):
        lines.append(",".join(map(repr, (0.1 * n, 0.5, 0.0, 0.0, 100.0 * (n + 1), *q))))
    (folder / "data.csv").write_text("\n".join(lines))
    (folder / "mapping.yaml").write_text(
        "title: Turned\ntime: {column: t, unit: s}\npressures: {columns: [p], unit: bar, reading: gauge}\n"
        f"tip:\n  position: {{columns: [x, y, z], unit: mm}}\n  uncertainty_mm: 0.1\n{offset}"
        f"  orientation: {{columns: [w, i, j, k], order: wxyz{keys}}}\n{rest}"
    )
    return runs.open(import_table(folder / "data.csv", folder / "mapping.yaml", folder / "out", "", "").archive).tip


def test_the_orientation_of_the_tip_follows_from_how_its_sensor_is_mounted(tmp_path: Path) -> None:
    tip = Rotation.from_rotvec([[0, 0, 0], [0, 40, 0], [0, 80, 0]], degrees=True)
    mounted, frame = Rotation.from_rotvec([10, -100, 20], degrees=True), Rotation.from_rotvec([0, 0, 30], degrees=True)
    # Of the sensor, in the tracker's frame, which is turned against the rod base.
    seen = frame.inv() * tip * mounted
    keys = ", uncertainty_deg: 0.4, rotation_deg: [-10, 100, -20]"
    found = kept(tmp_path, seen, keys, FRAME)
    expected = np.degrees(tip.as_rotvec())
    np.testing.assert_allclose(found.orientation_deg, expected, atol=1e-9)
    np.testing.assert_allclose(found.orientation_uncertainty_deg, 0.5, rtol=1e-9)
    aligned = kept(tmp_path, seen, ", uncertainty_deg: 0.4, aligned_rows: 1", FRAME)
    np.testing.assert_allclose(aligned.orientation_deg, expected, atol=1e-9)


def test_the_error_of_the_orientation_enters_a_point_beside_the_sensor(tmp_path: Path) -> None:
    keys, turns = ", uncertainty_deg: 0.4, rotation_deg: [0, 0, 0]", Rotation.identity(3)
    found = kept(tmp_path, turns, keys, offset="  offset_mm: [0, 0, 30]\n")
    moved = 30 * np.radians(0.4)
    np.testing.assert_allclose(found.uncertainty_mm[0], [np.hypot(0.1, moved), np.hypot(0.1, moved), 0.1])
    # A turn about y moves the point along x.
    assert found.cross_covariance_mm_deg[0][0, 1] == pytest.approx(moved * 0.4)


def test_an_orientation_without_a_stated_uncertainty_is_not_kept(tmp_path: Path) -> None:
    found = kept(tmp_path, Rotation.identity(3), "", offset="  offset_mm: [0, 0, 30]\n")
    assert np.isnan(found.orientation_deg).all()
    assert np.isfinite(found.measured_mm).all()


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        (", uncertainty_deg: 0.4", "rotation_deg or aligned_rows beside it"),
        (", uncertainty_deg: 0.4, aligned_rows: 2, rotation_deg: [0, 0, 0]", "one of them"),
        (", aligned_rows: 2", "uncertainty_deg beside it"),
        (", uncertainty_deg: 0, aligned_rows: 2", "a number above 0"),
        ("", "uncertainty_deg in it"),
    ],
)
def test_an_orientation_that_would_not_be_understood_is_refused(tmp_path: Path, keys: str, said: str) -> None:
    with pytest.raises(BadInputError, match=said):
        kept(tmp_path, Rotation.identity(3), keys)
