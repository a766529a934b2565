"""What the rows of a run add up to, however they are cut into portions."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from rig.realtime.run_totals import RunTotals
from runs.columns.observations import model_error_mm
from runs.records import observation_dtype, sample_dtype


def observations(errors_mm: list[float]) -> NDArray[np.void]:
    """Rows whose measured tip is so far from that of the model."""
    rows = np.zeros(len(errors_mm), observation_dtype(3))
    rows["measured_m"][:, 0] = 1e-3 * np.array(errors_mm)
    rows["dropped"] = np.arange(len(rows)) % 2
    return rows


@given(
    st.lists(st.floats(0.0, 100.0) | st.just(np.nan), min_size=1, max_size=30),
    st.sets(st.integers(1, 29), max_size=5),
)
def test_errors_and_gaps_do_not_depend_on_the_portions(errors_mm: list[float], cuts: set[int]) -> None:
    rows = observations(errors_mm)
    totals = RunTotals()
    portions = np.split(rows, sorted(cut for cut in cuts if cut < len(rows)))
    found = [totals.add_observations(portion) for portion in portions]
    error, mean = (np.concatenate(parts) for parts in zip(*found, strict=True))
    np.testing.assert_array_equal(error, model_error_mm(rows))
    known = [value for value in errors_mm if not np.isnan(value)]
    np.testing.assert_allclose(mean[-1], np.mean(known) if known else np.nan, atol=1e-9)
    assert totals.dropped == len(rows) // 2
    assert totals.observation == rows[-1] or np.isnan(errors_mm[-1])


def test_missed_deadlines_are_counted_over_all_rows() -> None:
    totals = RunTotals()
    rows = np.zeros(3, sample_dtype(3, 3))
    rows["missed"] = 0, 2, 1
    totals.add_samples(rows[:1])
    totals.add_samples(rows[1:])
    assert totals.missed == 3
