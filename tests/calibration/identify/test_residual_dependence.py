"""The permutation test finds what residuals depend on, and keeps its level for correlated frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from calibration.identify.poses import Poses
from calibration.identify.residual_dependence import SIGNIFICANT, Dependence, dependence
from calibration.identify.simulated_experiments import plan
from model.arrays import Array


def correlated(rng: np.random.Generator, count: int, memory: float) -> Array:
    """Rows (count, 3) of a first-order autoregressive process."""
    return np.asarray(lfilter([1.0], [1.0, -memory], rng.standard_normal((count + 200, 3)), axis=0))[200:]


def plateaus(rng: np.random.Generator) -> Poses:
    """Thirty poses with pressures in three chambers and weights."""
    return plan("plateaus", rng.uniform(0.05e5, 0.6e5, (30, 3)), rng.uniform(0.0, 1.0, 30))


def by_quantity(found: tuple[Dependence, ...]) -> dict[str, Dependence]:
    return {one.quantity: one for one in found}


def test_the_load_that_residuals_grow_with_is_named() -> None:
    rng = np.random.default_rng(1)
    poses = plateaus(rng)
    residual = rng.standard_normal((30, 3)) + 4.0 * poses.weight_kg[:, None] * np.array([0.0, 0.0, 1.0])
    found = by_quantity(dependence([residual], [poses], [False]))
    assert found["load"].significant
    assert found["load"].share is not None
    assert found["load"].share > 0.1
    assert not found["chamber combination"].significant


def test_a_product_of_pressures_shows_as_chamber_combination() -> None:
    rng = np.random.default_rng(2)
    poses = plateaus(rng)
    product = poses.pressure_pa[:, 0] * poses.pressure_pa[:, 1]
    residual = rng.standard_normal((30, 3)) + 3.0 * (product / product.std())[:, None]
    found = by_quantity(dependence([residual], [poses], [False]))
    assert found["chamber combination"].significant


def test_what_does_not_vary_within_a_run_has_no_verdict() -> None:
    rng = np.random.default_rng(3)
    poses = replace(plateaus(rng), weight_kg=np.full(30, 0.3))
    found = by_quantity(dependence([rng.standard_normal((30, 3))], [poses], [False]))
    assert found["load"].p_value is None
    assert not found["load"].significant


@pytest.mark.slow
def test_correlated_frames_are_called_significant_no_more_often_than_stated() -> None:
    rng = np.random.default_rng(4)
    level: list[float] = []
    for _ in range(60):
        count = 400
        # Pressures as slow as the errors: an independent exchange of the frames would call nearly all significant.
        course = correlated(rng, count, 0.97) * 1e4 + 4e4
        poses = plan("motion", course, period_s=1 / 30)
        found = by_quantity(dependence([correlated(rng, count, 0.97)], [poses], [True]))
        assert found["pressure"].p_value is not None
        level.append(found["pressure"].p_value)
    assert np.mean(np.array(level) < 0.1) < 0.22
    assert np.mean(np.array(level) < SIGNIFICANT) < 0.07
