"""A real arm, measured by others, by commands and archives alone: identified on the first 36 s, predicted beyond, where
its pressures are higher, and under load; and loaded runs made up by the model.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.io import savemat
from scipy.spatial.transform import Rotation

import model
from calibration.identify import Setup
from model.arrays import Array
from model.statics import statics
from rig.config.arm_model import model_arm
from rig.config.loader import load
from tests.support.command_line import status_of
from tests.support.shared_data import shared_data

pytestmark = pytest.mark.slow


EXAMPLES = Path(__file__).parents[3] / "docs" / "examples"
FREE = "youngs_modulus_pa,base_x_m,base_y_m,base_z_m,base_rx_rad,base_ry_rad,tool"
TWISTS = "actuator_angles,sensor_2_gain,sensor_3_gain"


def rig(*arguments: str | Path) -> None:
    assert status_of(*arguments) == 0


def brought(table: Path, mapping: Path, folder: Path) -> Path:
    before = set(folder.glob("*.h5"))
    rig("import", table, "--mapping", mapping, "--out", folder)
    (archive,) = set(folder.glob("*.h5")) - before
    return archive


def predicted(said: str, run: str) -> tuple[float, float, float]:
    """Rms, mean and 95 % [mm] of a run that was left out."""
    numbers = rf"{run} \(left out[^)]*\): rms [\d.]+ -> ([\d.]+) mm, mean ([\d.]+) mm, 95 % below ([\d.]+) mm"
    (found,) = re.findall(numbers, said)
    rms, mean, most = map(float, found)
    return rms, mean, most


def test_the_unseen_part_and_a_loaded_run_are_predicted_better_than_by_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    archive = brought(shared_data("stiff_flop", "NoLoad.mat"), EXAMPLES / "stiff-flop.yaml", tmp_path)
    loaded = brought(shared_data("stiff_flop", "Load1.mat"), EXAMPLES / "stiff-flop-loaded.yaml", tmp_path)
    found = tmp_path / "arm.yaml"
    options = ["--split-s", "36", "--quasi-static", "--every", "6", "--free", f"{FREE},{TWISTS}", "--to", found]
    rig("identify", archive, *options, "--leave-out", loaded)
    said = capsys.readouterr().out
    rms, mean, most = predicted(said, f"{archive.stem} from 36 s")
    assert rms < 2.6
    assert mean < 2.0
    assert mean < rms < most
    assert predicted(said, loaded.stem)[0] < 5
    fitted = yaml.safe_load(found.read_text())
    assert fitted["residuals"]["rms_mm"] < 0.9


# The arm as its example starts, but stiffer, and mounted as its sensors are.
START = model_arm(load(EXAMPLES / "stiff-flop-arm.yaml"))
TRUTH = Setup(
    START.with_segment(material=replace(START.material, youngs_modulus_pa=180e3)),
    base_translation_m=(-0.014, -0.001, 0.014),
    base_rotation_rad=(-0.04, -0.02, 0.0),
    tool_offset_m=(0.0157, 0.0, 0.006),
)
AMBIENT_BAR = np.array([1.030, 1.020, 1.038])
MOUNTED = Rotation.from_rotvec([-29.8, -177.0, -0.2], degrees=True)
"""From the tip sensor's axes to the tracker's while the arm is straight."""
CELL_M = np.array([-0.0145, 0.0, 0.0])
"""From the tip sensor to the load cell, along the cell's axes, which are the tracker's while the arm is straight."""
STATES = 10
"""Rows that one state lasts."""


def solved(bar: Array, force_n: Array) -> tuple[Array, Rotation]:
    """Where the tip sensor is, and how the tip is turned, under a pull at the load cell [tracker's axes]."""
    turn, arm, rotation = Rotation.from_rotvec(TRUTH.base_rotation_rad), TRUTH.arm, Rotation.identity()
    force = turn.inv().apply(force_n)
    straight = turn * Rotation.from_matrix(statics(arm, np.zeros(3)).tip_rotation)
    for _ in range(25 if force.any() else 1):
        cell_m = (rotation * straight.inv()).apply(CELL_M)
        lever_m = rotation.apply(np.array(TRUTH.tool_offset_m)) + cell_m
        loads = model.Loads(tip_force_n=force, tip_moment_n_m=np.cross(lever_m, force))
        shape = statics(arm, bar * 1e5, loads)
        rotation = Rotation.from_matrix(shape.tip_rotation)
    return TRUTH.measured(shape.tip_m[None], shape.tip_rotation[None])[0], turn * rotation * straight.inv()


def recorded(bar: Array, force_n: Array, zero: Array) -> Array:
    """Rows (n, 30) of states (k, 3) and (k, 3) as the arm's authors lay them out; the cell reads `zero` (6,) more.

    The base sensor wanders with the whole bench by a millimetre.
    """
    rng, rows = np.random.default_rng(5), []
    for k, (state, force) in enumerate(zip(bar, force_n, strict=True)):
        tip_m, turned = solved(state, force)
        # Beside its zero the cell reads the pull along its own axes, and no moment: it is pulled at its origin.
        wrench = np.concatenate([turned.inv().apply(force), np.zeros(3)]) + zero
        tip_q, base_q = (turned * MOUNTED).as_quat()[[3, 0, 1, 2]], [0.0121, -0.1448, -0.9893, -0.9893]
        for row in range(k * STATES, (k + 1) * STATES):
            base_mm = [0.5, 0.66 + row / 200, -157.2]
            seen_mm = base_mm + 1e3 * tip_m + rng.normal(0, 0.02, 3)
            rows.append([*np.zeros(6), row / 20, *(state + AMBIENT_BAR), *base_mm, *base_q, *seen_mm, *tip_q, *wrench])
    return np.array(rows)


def leading(rows: Array) -> Array:
    """Rows (n, 30) whose pressures lead the tip by four rows, 0.2 s, as those of the loaded runs."""
    out = rows.copy()
    out[:-4, 7:10] = rows[4:, 7:10]
    return out


def test_a_loaded_run_is_predicted_from_an_unloaded_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(6)
    steps = np.concatenate([level * np.roll(np.eye(3), turn, 0) for turn, level in enumerate((0.35, 0.7, 1.0))])
    bar = np.concatenate([np.zeros((3, 3)), steps])
    none = np.zeros_like(bar)
    savemat(tmp_path / "NoLoad.mat", {"NoLoad": recorded(bar, none, np.zeros(6))[:, 6:24]})
    unloaded = brought(tmp_path / "NoLoad.mat", EXAMPLES / "stiff-flop.yaml", tmp_path)

    pulled = rng.uniform(-1, 1, bar.shape) * [0.5, 0.5, 1.0]
    pulled[:3] = 0
    zero = np.array([0.4, -0.3, 1.2, 8.0, -5.0, 2.0])
    savemat(tmp_path / "Load1.mat", {"Load1": leading(recorded(bar, pulled, zero))})
    mapping = EXAMPLES / "stiff-flop-loaded.yaml"
    loaded = brought(tmp_path / "Load1.mat", mapping, tmp_path)

    (tmp_path / "stiff-flop-arm.yaml").write_text((EXAMPLES / "stiff-flop-arm.yaml").read_text())
    told = mapping.read_text()
    for old, new in (
        ("ambient_rows: 20", f"ambient_bar: {AMBIENT_BAR.tolist()}"),
        ("aligned_rows: 20\n  zero_rows: 20", "rotation_deg: [29.8, 177.0, 0.2]"),
        ("variable: Load1", "variable: Bent"),
    ):
        assert told.count(old) == 1
        told = told.replace(old, new)
    (tmp_path / "bent.yaml").write_text(told)
    savemat(tmp_path / "Bent.mat", {"Bent": leading(recorded(bar[::-1], pulled[::-1], np.zeros(6)))})
    bent = brought(tmp_path / "Bent.mat", tmp_path / "bent.yaml", tmp_path)

    (tmp_path / "wrong.yaml").write_text(mapping.read_text().replace("on: arm", "on: surroundings"))
    wrong = brought(tmp_path / "Load1.mat", tmp_path / "wrong.yaml", tmp_path)

    unseen = [word for archive in (loaded, bent, wrong) for word in ("--leave-out", archive)]
    rig("identify", unloaded, "--quasi-static", "--every", "5", "--free", FREE, *unseen)
    said = capsys.readouterr().out
    assert predicted(said, loaded.stem)[0] < 0.2
    assert predicted(said, bent.stem)[0] < 0.2
    assert predicted(said, wrong.stem)[0] > 2
