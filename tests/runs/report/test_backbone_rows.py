"""Backbones of a periodic motion stand at even phases of one period."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from runs.report.figures import SHAPES, _shapes


def test_backbones_of_a_sinusoid_do_not_alias_with_its_period() -> None:
    # Twelve even times over 11 s of a 1 s period would all be at one phase.
    control, frames = np.arange(0, 11, 0.005), np.arange(0, 11, 0.02)
    setpoint = 0.5 + 0.2 * np.sin(2 * np.pi * control)
    run: Any = SimpleNamespace(
        tip=SimpleNamespace(model_ok=np.ones(len(frames), bool), protocol_s=frames, time_s=frames),
        pressure=SimpleNamespace(protocol_s=control, setpoint_bar=setpoint[:, None]),
    )
    summary: Any = SimpleNamespace(
        steps=(SimpleNamespace(dwell=False, start_s=0.0, stop_s=11.0, extreme_bar=0.5, weight_g=0.0, error_mm=0.0),)
    )
    rows, phases, label = _shapes(run, summary)
    assert len(rows) == SHAPES
    assert frames[rows] % 1.0 * 360 == pytest.approx(phases, abs=4)
    assert np.diff(phases) == pytest.approx(360 / SHAPES)
    assert label.startswith("phase")
