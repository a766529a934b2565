"""Amplitude, lag and loop of periodic motions against known ones."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from runs.archive.reader import ArchiveReader
from runs.periodic_motion import _lag_ms, _motion, fundamental, goes_round, loop_percent
from runs.records import DetectionStatus


@pytest.mark.parametrize(("amplitude", "lag_s"), [(1.0, 0.0), (3.0, 0.05), (0.5, -0.02)])
def test_amplitude_and_lag_of_a_sinusoid_are_found_in_noise_and_with_gaps(amplitude: float, lag_s: float) -> None:
    random = np.random.default_rng(2)
    time = np.arange(0.3, 6.3, 1 / 30)
    asked = fundamental(time, 0.2 + 0.1 * np.sin(2 * np.pi * time / 2.0), 2.0)
    values = 7 + amplitude * np.sin(2 * np.pi * (time - lag_s) / 2.0) + random.normal(0, 1e-3, len(time))
    values[10:20] = np.nan
    found = fundamental(time, values, 2.0)
    assert abs(asked) == pytest.approx(0.1)
    assert abs(found) == pytest.approx(amplitude, abs=1e-3)
    assert _lag_ms(asked, found, 2.0) == pytest.approx(1e3 * lag_s, abs=1.0)
    assert _lag_ms(asked, -found, 2.0, either_sign=True) == pytest.approx(1e3 * lag_s, abs=1.0)


def test_the_loop_of_an_ellipse_is_its_area_and_a_line_has_none() -> None:
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    assert loop_percent(np.cos(angle), 5 * np.sin(angle)) == pytest.approx(100 * math.pi / 4, rel=1e-3)
    assert loop_percent(np.cos(angle), 3 * np.cos(angle)) == pytest.approx(0, abs=1e-9)
    assert math.isnan(loop_percent(angle, np.full(400, np.nan)))


def test_the_loop_is_that_of_the_pressure_at_each_frame_whatever_the_age_of_the_models_input() -> None:
    lag, time, frames = 0.02, np.arange(0, 4 * np.pi, 0.005), np.arange(0, 4 * np.pi, 1 / 30)
    columns = {
        "pressure": {"protocol_s": time, "setpoint_bar": np.sin(time)[:, None], "measured_bar": np.sin(time)[:, None]},
        "tip": {
            "protocol_s": frames,
            "seen": np.full(len(frames), DetectionStatus.MEASURED),
            "measured_mm": np.outer(np.sin(frames - lag), (20, 0, 0)),
            "model_mm": np.outer(np.sin(frames), (20, 0, 0)),
            "pressure_bar": np.sin(frames - 0.002)[:, None],
            "error_mm": np.zeros(len(frames)),
        },
    }
    run = cast("ArchiveReader", SimpleNamespace(**{name: SimpleNamespace(**part) for name, part in columns.items()}))
    motion = _motion(run, "sine", 2 * np.pi * np.arange(3))
    assert motion.tip_loop_percent == pytest.approx(100 * np.pi / 4 * np.sin(lag), rel=0.02)
    assert motion.model_loop_percent == pytest.approx(0, abs=0.02)


def test_too_few_values_have_no_amplitude() -> None:
    assert math.isnan(abs(fundamental(np.arange(3.0), np.arange(3.0), 2.0)))


def test_a_circle_goes_round_and_a_line_and_a_figure_eight_do_not() -> None:
    random = np.random.default_rng(4)
    time = np.arange(0.3, 8.3, 1 / 30)
    once = 2 * np.pi * time / 4.0
    noise = random.normal(0, 0.1, (len(time), 3))

    def round_one(x: NDArray[np.float64], y: NDArray[np.float64]) -> bool:
        return goes_round(time, np.stack([x, y, 0 * x], axis=1) + noise, 4.0)

    assert round_one(20 * np.cos(once), 20 * np.sin(once))
    assert round_one(15 * np.sign(np.cos(once)), 15 * np.sign(np.sin(once)))
    assert not round_one(15 * np.sin(once), 7.5 * np.sin(2 * once))
    assert not round_one(15 * np.sin(once), 5 * np.sin(once + 0.2))
    assert not goes_round(time, np.full((len(time), 3), np.nan), 4.0)
