"""Periods of set-points against known sinusoids."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from runs.periods import last_period


@given(period=st.floats(0.3, 3.0), phase=st.floats(0.0, 6.28))
def test_the_last_period_of_a_sinusoid_is_found(period: float, phase: float) -> None:
    time = np.arange(0, 10, 0.005)
    moving = 0.5 + 0.2 * np.sin(2 * np.pi * time / period + phase)
    found = last_period(time, np.column_stack((np.full_like(time, 0.1), moving)))
    assert found is not None
    start, stop = found
    assert stop - start == pytest.approx(period, rel=5e-3)
    turns = start / period + phase / (2 * np.pi)
    assert turns == pytest.approx(round(turns), abs=0.02)
    assert time[-1] - stop < period + 0.005


@pytest.mark.parametrize(
    "setpoints",
    [
        np.zeros(100),
        np.linspace(0, 1, 100),
        np.sin(np.linspace(0, 6, 100) ** 2),
        np.full(100, np.nan),
    ],
)
def test_set_points_that_do_not_repeat_have_no_period(setpoints: np.ndarray) -> None:
    assert last_period(np.linspace(0, 1, 100), setpoints[:, None]) is None
