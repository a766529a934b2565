"""Orientations in every way that trackers write them place the tool centre point alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import runs
from protocols import BadInputError
from rig.importing import import_table

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
