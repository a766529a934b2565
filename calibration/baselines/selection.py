"""Fits of the baselines: lag and regularisation are chosen by blocks that are left out of the fit's own data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.baselines.methods import BASELINES, BaselineMethod, PredictTips
from calibration.baselines.tip_inputs import TipInputs, inputs_of, joined
from calibration.identify.fitting.blocks_left_out import BLOCKS
from calibration.identify.observations.poses import Poses
from model.arrays import Array

Triple = tuple[float, float, float]

# First-order lags [s] that are tried: from none to the creep of a plateau.
LAGS_S = (0.0, 0.1, 0.2, 0.5, 2.0, 10.0)
# Entries that a baseline is fitted to: more cost time and say nothing new.
MOST_ENTRIES = 600


@dataclass(frozen=True)
class BaselineFit:
    """A fitted baseline.

    block_error_m (K, 3): its errors on blocks in time that were left out of the fit's data. Their covariance is what it
    states of a prediction.
    """

    name: str
    lag_s: float
    weight: float
    block_error_m: Array
    gravity: Triple
    predict_inputs: PredictTips

    @property
    def covariance_m2(self) -> Array:
        """Covariance (3, 3) of the errors on blocks that were left out."""
        out: Array = self.block_error_m.T @ self.block_error_m / len(self.block_error_m)
        return out

    def predict(self, poses: Poses) -> Array:
        """Predicted tips (K, 3) [m] of the entries with a tip."""
        return self.predict_inputs(inputs_of(poses, self.lag_s, self.gravity))


def fit_baselines(
    data: Sequence[Poses], gravity: Triple, methods: Sequence[BaselineMethod] = BASELINES
) -> tuple[BaselineFit, ...]:
    """Fit each baseline to runs with tips; gravity [m/s^2] in the frame of the tips."""
    lags = LAGS_S if any(one.moving or one.course is not None for one in data) else LAGS_S[:1]
    by_lag = {lag_s: [_thinned(inputs_of(one, lag_s, gravity), len(data)) for one in data] for lag_s in lags}
    return tuple(_fit(method, by_lag, gravity) for method in methods)


def _fit(method: BaselineMethod, by_lag: dict[float, list[TipInputs]], gravity: Triple) -> BaselineFit:
    """The baseline with the lag and the weight whose errors on blocks left out are smallest."""
    tried = [
        (lag_s, weight, _left_out(method, data, weight))
        for lag_s, data in by_lag.items()
        for weight in method.weights
        if method.name != "no motion" or lag_s == 0
    ]
    lag_s, weight, errors = min(tried, key=lambda one: float((one[2] ** 2).sum()))
    predict = method.fit(joined(by_lag[lag_s]), weight)
    return BaselineFit(method.name, lag_s, weight, errors, gravity, predict)


def _left_out(method: BaselineMethod, data: Sequence[TipInputs], weight: float) -> Array:
    """Errors (K, 3) [m] of the tips of each block in time, predicted from the others."""
    whole = joined(list(data))
    block = np.concatenate([np.arange(len(one)) * BLOCKS // max(len(one), 1) for one in data])
    errors = np.zeros_like(whole.tip_m)
    for number in range(BLOCKS):
        out = block == number
        if out.any() and not out.all():
            errors[out] = whole.tip_m[out] - method.fit(whole.only(~out), weight, quick=True)(whole.only(out))
    return errors


def _thinned(data: TipInputs, runs: int) -> TipInputs:
    """Every n-th entry of one of several runs."""
    return data.only(np.arange(0, len(data), max(1, -(-len(data) * runs // MOST_ENTRIES))))
