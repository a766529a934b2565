"""What stands in kernels in the place of loops over lanes does what those loops do."""

from __future__ import annotations

import numba
import numpy as np

from model.kernels.layout import LANES, STATE
from model.kernels.simd import broadcast, horizontal_sum, horizontal_sum_slopes

ROWS = 3


def step(weights, lanes, x, moved, w):  # type: ignore[no-untyped-def]
    broadcast(w, 3, weights[1, 2])
    for j in range(ROWS):
        horizontal_sum(weights, 1, lanes, j, x, moved)
        horizontal_sum_slopes(weights, 1, lanes, j, x, ROWS + j, moved)


def arrays(seed: int) -> tuple[np.ndarray, ...]:
    random = np.random.default_rng(seed)
    weights, lanes = random.normal(size=(2, LANES)), random.normal(size=(ROWS, STATE * LANES))
    return weights, lanes, np.zeros((2 * ROWS, STATE)), np.zeros((2, STATE)), np.zeros(5 * LANES)


def test_simd_instructions_equal_the_loops_that_define_them() -> None:
    compiled, plain = arrays(1), arrays(1)
    kernel = numba.njit(step)
    kernel(*compiled)
    step(*plain)
    for got, wanted in zip(compiled, plain, strict=True):
        np.testing.assert_allclose(got, wanted, rtol=1e-13, atol=1e-14)
    assert (compiled[4] != 0).sum() == LANES

    # A NaN in one lane of one row, and not the last one, is not lost in the totals.
    for c in range(STATE):
        broken = arrays(2)
        broken[1][1, c * LANES + 5] = np.nan
        kernel(*broken)
        assert np.isnan(broken[3][1]).tolist() == [k == c for k in range(STATE)]
