"""A whole run in virtual time at another control rate than the default."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rig.config import loader
from tests.support.virtual_runs import protocol_file, virtual_run

STEPS = (
    "  - hold: {actuators: [1], level_bar: 0.3, duration_s: 1}\n  - ramp: {actuators: [1], to_bar: 0, duration_s: 1}\n"
)


@pytest.mark.parametrize("rate_hz", [100.0, 250.0])
def test_a_run_keeps_the_control_rate_of_the_rig(tmp_path: Path, rate_hz: float) -> None:
    rig, text = tmp_path / "rig.yaml", loader.text("mock-no-camera")
    assert text.count("rate_hz: 200") == 1
    rig.write_text(text.replace("rate_hz: 200", f"rate_hz: {rate_hz:g}"))
    run = virtual_run(protocol_file(tmp_path, STEPS), rig, folder=tmp_path)
    pressure = run.pressure
    assert run.header.control_hz == rate_hz
    assert np.median(np.diff(pressure.time_s)) == pytest.approx(1 / rate_hz, rel=1e-3)
    assert len(pressure.time_s) == pytest.approx(2 * rate_hz, abs=2)
    held = (pressure.protocol_s > 0.6) & (pressure.protocol_s < 0.9)
    assert np.abs(pressure.measured_bar[held, 0] - 0.3).max() < 0.01
