"""Sums over the lanes, and broadcasts into them, against NumPy."""

from __future__ import annotations

import numba
import numpy as np

from model.kernels.lane_sums import broadcast, horizontal_sum, horizontal_sum_slopes
from model.kernels.layout import LANES, STATE

ROWS = 3


@numba.njit
def step(weights, lanes, x, moved, w):  # type: ignore[no-untyped-def]
    broadcast(w, 3, weights[1, 2])
    for j in range(ROWS):
        horizontal_sum(weights, 1, lanes, j, x, moved)
        horizontal_sum_slopes(weights, 1, lanes, j, x, ROWS + j, moved)


def arrays(seed: int) -> tuple[np.ndarray, ...]:
    random = np.random.default_rng(seed)
    weights, lanes = random.normal(size=(2, LANES)), random.normal(size=(ROWS, STATE * LANES))
    return weights, lanes, np.zeros((2 * ROWS, STATE)), np.zeros((2, STATE)), np.zeros(5 * LANES)


def test_rows_are_lane_zero_plus_the_weighted_sum_of_the_lanes() -> None:
    weights, lanes, x, moved, w = arrays(1)
    step(weights, lanes, x, moved, w)
    split = lanes.reshape(ROWS, STATE, LANES)
    change = split @ weights[1]
    rows = split[:, :, 0] + change
    np.testing.assert_allclose(x[:ROWS], rows, rtol=1e-12)
    np.testing.assert_allclose(x[ROWS:, :12], rows[:, :12], rtol=1e-12)
    assert (x[ROWS:, 12:] == 0).all()
    np.testing.assert_allclose(moved[0], np.abs(change).max(axis=0), rtol=1e-12)
    total = np.abs(change).sum(axis=0)
    total[:12] += rows[:, :12].sum(axis=0)
    np.testing.assert_allclose(moved[1], total, rtol=1e-11, atol=1e-12)
    assert w[3 * LANES : 4 * LANES].tolist() == [weights[1, 2]] * LANES
    assert (w != 0).sum() == LANES


def test_a_nan_in_one_lane_of_one_row_is_not_lost_in_the_totals() -> None:
    for c in range(STATE):
        weights, lanes, x, moved, w = arrays(2)
        lanes[1, c * LANES + 5] = np.nan
        step(weights, lanes, x, moved, w)
        assert np.isnan(moved[1]).tolist() == [k == c for k in range(STATE)]
