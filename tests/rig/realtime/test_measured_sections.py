"""Boards along the arm in real time: the simulator gives their poses to the camera through shared memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import runs
from rig.config import loader
from runs.columns import DetectionStatus
from scripts.faults.trial_run import PROTOCOL, TrialBench, TrialRun
from tests.support.sectioned_bench import sectioned

pytestmark = pytest.mark.realtime

PROTOCOL_TEXT = PROTOCOL.format(moving_s=1.5)


def test_sections_are_measured_while_the_arm_moves(tmp_path: Path) -> None:
    bench = TrialBench("mock-charuco", PROTOCOL_TEXT)
    assert sectioned(loader.text(bench.rig)) != loader.text(bench.rig)
    run = TrialRun(tmp_path, bench=bench, edit=sectioned, protocol=PROTOCOL_TEXT, limits={"hung_s": 5.0})
    try:
        assert run.process.wait(120) == 0, run.output
    finally:
        run.close()
    sections = runs.open(next(run.out.glob("*.h5"))).sections
    assert sections is not None
    measured = sections.seen == DetectionStatus.MEASURED
    assert np.all(measured.mean(axis=0) > 0.8)
    for k in range(2):
        assert np.nanmax(sections.error_mm[:, k]) < 10.0
        assert np.ptp(sections.measured_mm[measured[:, k], k, 2]) > 0.5, "it moves along the arm"
