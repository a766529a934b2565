"""`rig simulate`: the model alone carries what prompts hang on it, and says which steps it could not solve."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import runs
from model.statics import statics
from rig.config.arm_model import TipLoad, model_arm
from rig.config.loader import load, text
from rig.experiment.options import RunOptions
from rig.experiment.prepare import prepare
from rig.experiment.simulate import simulate
from runs.run import Run

WEIGHED = """
title: A weight
steps:
  - hold: {duration_s: 0.2}
  - prompt: {message: Hang it., weight_g: 800}
  - hold: {duration_s: 0.2}
"""


def simulated(folder: Path, mode: str, rig: str) -> Run:
    (folder / "weight.yaml").write_text(WEIGHED)
    (folder / "rig.yaml").write_text(f"{rig}\nmodel: {{mode: {mode}}}\n")
    prepared = prepare(str(folder / "weight.yaml"), str(folder / "rig.yaml"), RunOptions(out=folder))
    return runs.open(simulate(prepared))


def test_a_prompts_weight_stretches_the_arm(tmp_path: Path) -> None:
    tip = simulated(tmp_path, "static", text("mock")).tip
    assert tip.weight_g[0] == 0
    assert tip.weight_g[-1] == 800
    config = load("mock")
    alone = statics(model_arm(config), np.zeros(3), TipLoad(config).carrying(0.8)).tip_m
    np.testing.assert_allclose(tip.model_mm[-1], 1e3 * alone, atol=1e-6)
    assert tip.model_mm[-1, 2] > tip.model_mm[0, 2] + 2


@pytest.mark.parametrize("mode", ["static", "dynamic"])
def test_rows_without_equilibrium_are_flagged_and_the_others_kept(tmp_path: Path, mode: str) -> None:
    weak = (
        text("mock").replace("cap_mass_g: 50\n", "cap_mass_g: 0\n").replace("a2_per_N2: 0.00031962", "a2_per_N2: 100")
    )
    run = simulated(tmp_path, mode, weak)
    tip, carries_nothing = run.tip, run.tip.weight_g == 0
    assert not tip.model_ok[-1]
    assert tip.model_ok[carries_nothing].all()
    np.testing.assert_allclose(tip.model_mm, np.broadcast_to([0.0, 0.0, 170.0], tip.model_mm.shape), atol=1e-6)
    assert f"of {len(tip.model_ok)} steps could not be solved" in run.message
