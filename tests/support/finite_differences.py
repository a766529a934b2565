"""Slopes of a forward beside central differences."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from calibration.identify import Poses, Setup, named
from calibration.identify.prediction.forward_model import ForwardModel
from calibration.identify.unknowns.unknown import unknowns_of

STEP = 1e-4


def forward_of(data: Sequence[Poses], start: Setup, free: Iterable[str], substeps: int = 0) -> ForwardModel:
    """A forward with some free parameters and no priors that are stated."""
    parameters = named(free, data[0].actuators)
    return ForwardModel(data, start, unknowns_of(start, len(data), parameters, (), {}), substeps)


def check_slopes(forward: ForwardModel, shape: tuple[int, int]) -> None:
    """Compare the slopes (K, D, P) of the first run with central differences of its gaps (K, D) of this shape."""
    theta = forward.first + np.linspace(-0.3, 0.3, len(forward.unknowns)) * forward.span
    slopes = forward.slopes(theta)[0] * forward.span
    assert slopes.shape == (*shape, len(theta))
    for i, step in enumerate(np.diag(STEP * forward.span)):
        numerical = (forward.gaps(theta - step)[0] - forward.gaps(theta + step)[0]) / (2 * STEP)
        np.testing.assert_allclose(slopes[:, :, i], numerical, atol=2e-5 * max(1.0, np.abs(numerical).max()))
