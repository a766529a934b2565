"""A simulated camera whose driver gives late times: the archive has the truth of the times that it states."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import rig.config.loader
from tests.support.virtual_runs import protocol_file, virtual_run

STEPS = """
  - ramp: {actuators: [1], to_bar: 0.4, duration_s: 0.8}
  - hold: {duration_s: 0.3}
"""
DELAY_FRAMES = 3


def test_a_late_time_has_the_truth_of_that_time(tmp_path: Path) -> None:
    text = rig.config.loader.text("mock")
    late_file = tmp_path / "late.yaml"
    delay_s = DELAY_FRAMES / 30
    late_file.write_text(text.replace("  scene: {", f"  scene: {{stamp_delay_ms: {delay_s * 1e3:.6f}, "))
    protocol = protocol_file(tmp_path, STEPS)
    exact = virtual_run(protocol, "mock", folder=tmp_path / "exact")
    late = virtual_run(protocol, late_file, folder=tmp_path / "late")
    common = min(len(late.tip.time_s), len(exact.tip.time_s) - DELAY_FRAMES)
    assert common > 20
    same = slice(DELAY_FRAMES, DELAY_FRAMES + common)
    np.testing.assert_allclose(late.tip.time_s[:common], exact.tip.time_s[same], atol=1e-6)
    np.testing.assert_allclose(late.simulated.tip_mm[:common], exact.simulated.tip_mm[same], atol=1e-4)
    # The pictures are older than their times: this is the error that the option is for.
    error_mm = np.linalg.norm(late.tip.measured_mm - late.simulated.tip_mm, axis=1)[:common]
    assert np.nanmax(error_mm) > 0.1 * np.ptp(exact.simulated.tip_mm, axis=0).max()
