"""Unknowns that the data leave open: held at their start with an assumed error that enters the other error bars."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import model
from calibration.identify import Fit, Prior, Setup, identify
from calibration.identify.nuisance import stated_values
from calibration.identify.results import Verdict
from calibration.identify.simulated_experiments import MeasurementErrors, perform, plan

START = Setup(model.Arm.paper())
RAMP = np.linspace(0.0, 0.65e5, 11)[:, None] * np.array([1.0, 0, 0])
FINE = MeasurementErrors((1e-4, 1e-4, 1e-4), 20.0, 50.0)
# One ramp of one chamber determines the radial effect only from fine data: these finest two of five do.
SHARES = (0.18, 0.09, 0.06, 0.045, 0.03)


def fit_of(share: float, stated: dict[str, Prior] | None) -> Fit:
    errors = replace(
        FINE,
        tip_m=tuple(share * one for one in FINE.tip_m),
        pressure_pa=share * FINE.pressure_pa,
        offset_pa=share * FINE.offset_pa,
    )
    poses = perform(plan("ramp-a", RAMP, errors=errors), START, np.random.default_rng(1), errors)
    return identify([poses], START, ("law", "rpe_per_bar", "base"), stated=stated)


@pytest.mark.slow
@pytest.mark.parametrize("uncertain", [False, True])
def test_finer_data_widen_no_error_bar_where_an_unknown_becomes_determined(uncertain: bool) -> None:
    stated = {name: Prior(p.mean, 0.05 * p.std) for name, p in stated_values(START, {}).items()} if uncertain else None
    fits = [fit_of(share, stated) for share in SHARES]
    held = [fit["rpe_per_bar"].value is None for fit in fits]
    assert (held[0], held[-1]) == (True, False)
    of = [e.name for e in fits[0].estimates].index("a1_per_n")
    stds = np.array([np.sqrt(fit.fitted_covariance[of, of]) for fit in fits])
    assert (np.diff(stds) < 0.01 * stds[:-1]).all(), stds


def test_an_unknown_without_effect_is_held_with_half_a_span() -> None:
    poses = perform(plan("rest", np.zeros((3, 3)), errors=FINE), START, np.random.default_rng(2), FINE)
    fit = identify([poses], START, ("rpe_per_bar", "base_z_m"))
    assert fit.fixed[0]
    assert np.sqrt(fit.joint_covariance[0, 0]) == pytest.approx(0.5, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("growth_per_bar", [0.12, 0.3])
def test_an_effect_that_the_model_lacks_is_not_published_as_a_parameter_far_from_its_start(
    growth_per_bar: float,
) -> None:
    """The push grows with the pressure. The data alone explain it by a radial effect that is wrong by twice the truth.

    With the stronger growth the curvature of the likelihood at the minimum would determine it.
    """
    bar = np.linspace(0.15, 0.65, 11)[:, None] * np.array([1.0, 0, 0])
    errors = MeasurementErrors((3e-5, 3e-5, 3e-5), 20.0, 100.0)
    grown = 1e5 * bar * (1 + growth_per_bar * bar)
    poses = perform(plan("ramp-a", 1e5 * bar, errors=errors), START, np.random.default_rng(2), errors, felt_pa=grown)
    steps: list[str] = []
    stated = stated_values(START, {})
    fit = identify([poses], START, ("law", "rpe_per_bar", "base"), stated=stated, progress=steps.append)
    assert fit["rpe_per_bar"].verdict is Verdict.OBSCURED
    # What follows the search takes as long as the search, so it is reported, too.
    after = [step for step in steps if not step.startswith("start 1")]
    assert after[-2:] == [
        "posterior of the parameters and of the effects that the model lacks",
        "fit together with these effects",
    ]
    assert sum(step.endswith("undetermined unknowns held") for step in after) >= 1
    interval = fit["a1_per_n"].interval
    assert interval is None or interval[0] < START.arm.material.a1_per_n < interval[1]
    assert interval is not None or growth_per_bar > 0.2


@pytest.mark.slow
def test_an_effect_that_the_model_lacks_is_not_published_as_a_parameter_at_its_bound() -> None:
    """The push falls behind the pressure. The data alone explain it by a wall that does not soften: a2 of zero."""
    bar = np.linspace(0.15, 0.65, 11)[:, None] * np.array([1.0, 0, 0])
    errors = MeasurementErrors((3e-5, 3e-5, 3e-5), 20.0, 100.0)
    fallen = 1e5 * bar * (1 - 0.3 * bar)
    poses = perform(plan("ramp-a", 1e5 * bar, errors=errors), START, np.random.default_rng(2), errors, felt_pa=fallen)
    fit = identify([poses], START, ("law", "rpe_per_bar", "base"), stated=stated_values(START, {}))
    assert fit["a2_per_n2"].value is None
    assert fit["a2_per_n2"].verdict is Verdict.OBSCURED
