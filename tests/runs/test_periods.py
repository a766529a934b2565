"""Periods of set-points against known sinusoids."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from runs.periodic_motion import last_period, whole_periods


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


@given(count=st.integers(3, 6), part=st.floats(0.0, 0.9), phase=st.floats(0.0, 6.28))
def test_every_period_that_fits_counts_whatever_its_phase(count: int, part: float, phase: float) -> None:
    time = np.arange(0, 1.5 * (count + part), 0.005)
    found = whole_periods(time, 0.3 + 0.2 * np.sin(2 * np.pi * time / 1.5 + phase)[:, None])
    assert found is not None
    assert len(found) - 1 == count
    assert found[0] == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(np.diff(found), 1.5, rtol=5e-3)


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
