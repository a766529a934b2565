"""What the page draws when it plays an archive."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

import tests.support.synthetic_runs as made_up
from rig.live.archived_run import ArchivedRun
from runs.archive.writer import finalise
from tests.support.command_line import status_of
from tests.support.import_bench import SMALL, imported_in

WEIGHED = """
title: A weight
steps:
  - hold: {duration_s: 0.5}
  - prompt: {message: Hang it., weight_g: 800}
  - hold: {duration_s: 1.5}
"""


def test_the_arm_is_drawn_with_the_weight_that_hung_on_it(tmp_path: Path) -> None:
    (tmp_path / "weight.yaml").write_text(WEIGHED)
    assert status_of("run", tmp_path / "weight.yaml", "--fast", "--yes", "--no-report", "--out", tmp_path) == 0
    played = ArchivedRun(next(tmp_path.glob("*.h5")))
    tip = played.run.tip
    assert tip.weight_g[-1] == 800
    for frame in (0, len(tip.frame) - 1):
        overlay = played.overlay(frame, -1)
        assert overlay is not None
        # The archive's model still swings a little where the weight has just been hung.
        assert np.linalg.norm(overlay.lines_mm[0, -1] - tip.model_mm[frame]) < 1.0


def test_an_import_without_rig_and_set_points_is_described_in_plain_json(tmp_path: Path) -> None:
    made = imported_in(tmp_path, "0,0.1,1,2,3\n1,0.2,1,2,3\n", SMALL)
    played = ArchivedRun(made.archive)
    about = json.dumps(asdict(played.about()), allow_nan=False)
    assert json.loads(about)["limit_bar"] == 0.2
    assert played.viewer().packet() is not None
    tip = played.now(1.0, 1, playing=False).tip
    assert tip is not None
    assert np.isnan(tip.mean_error_mm)  # of no error there is no mean, not one of 0 mm


def test_a_run_cut_off_between_a_frame_and_its_estimate_is_played_to_its_end(tmp_path: Path) -> None:
    played = ArchivedRun(finalise(made_up.write_cut_off_while_adapting(tmp_path / "adapting.mcap")))
    last = len(played.run.tip.frame) - 1
    shown = played.now(played.end_s, last, playing=False)
    assert shown.estimates == (("shear_ratio", "", "0.4", "0.1", "0.4"),)
    assert played.now(0.0, -1, playing=False).estimates == ()
