"""The compiled statistics of the corners agree with NumPy's."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from calibration.vision.corners import column_medians

VALUES = arrays(
    np.float64, array_shapes(min_dims=2, max_dims=2, max_side=12), elements=st.floats(-1e6, 1e6, allow_subnormal=False)
)


@given(VALUES)
def test_medians_are_those_of_numpy(values: np.ndarray) -> None:
    np.testing.assert_allclose(column_medians(values), np.median(values, axis=0), rtol=1e-15)
