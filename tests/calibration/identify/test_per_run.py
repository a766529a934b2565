"""A parameter with a value of its own in each run, as the mounting of an arm that was taken down between the runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import model
from calibration.identify import Prior, Setup, UnknownParameter, identify
from calibration.identify.fitting.held_out_prediction import predict
from calibration.identify.fitting.results import Fit
from calibration.identify.observations.poses import Poses
from calibration.identify.simulated_experiments import MeasurementErrors, perform, plan
from calibration.identify.unknowns.nuisance import stated_values

START = Setup(model.Arm.paper())
MATERIAL = replace(START.arm.material, a1_per_n=0.0079, a2_per_n2=0.00034)
TRUTH = Setup(START.arm.with_segment(material=MATERIAL))
ERRORS = MeasurementErrors((3e-5, 3e-5, 3e-5), 10.0, 0.0)
RAMP = np.linspace(0.05e5, 0.6e5, 7)[:, None]
BASE = ("base_x_m", "base_y_m", "base_z_m")
MOUNTED_M = {"monday": (0.003, -0.001, 0.002), "friday": (-0.002, 0.002, 0.001), "later": (0.004, 0.0, 0.0)}
PRESSED = {"monday": [1.0, 0.0, 0.0], "friday": [0.0, 1.0, 1.0], "later": [0.0, 0.8, 0.2]}


def run(name: str) -> Poses:
    """A ramp on the arm as it was mounted on that day."""
    planned = plan(name, RAMP * np.array(PRESSED[name]), errors=ERRORS)
    setup = replace(TRUTH, base_translation_m=MOUNTED_M[name])
    found = perform(planned, setup, np.random.default_rng(len(name)), ERRORS)
    return replace(found, source=name)


RUNS = [run("monday"), run("friday")]


@pytest.fixture(scope="module")
def own() -> Fit:
    return identify(RUNS, START, ["law", *BASE], per_run=["base_translation"])


def test_each_run_gets_its_own_mounting_and_the_law_is_shared(own: Fit) -> None:
    for e in own.estimates:
        if e.name in BASE:
            true = MOUNTED_M[e.run][BASE.index(e.name)]
        else:
            assert e.run == ""
            true = getattr(MATERIAL, e.name)
        assert e.value is not None
        assert e.std is not None
        assert abs(e.value - true) < 4 * e.std, (e.name, e.run)
    assert len(own.estimates) == 2 + 2 * 3
    assert own.extra_m == 0.0


def test_one_mounting_for_both_runs_leaves_millimetres(own: Fit) -> None:
    shared = identify(RUNS, START, ["law", *BASE])
    assert shared.rms_m > 1e-3
    assert own.rms_m < 1e-4


def test_a_new_run_is_expected_at_the_mean_mounting_with_the_stated_uncertainty_around_it(own: Fit) -> None:
    mean = np.mean([MOUNTED_M["monday"], MOUNTED_M["friday"]], axis=0)
    assert own.setup.base_translation_m == pytest.approx(tuple(mean), abs=2e-4)
    new = predict(own, run("later"))
    # 2 mm along each axis is the default uncertainty of a mounting.
    assert new.std_m > 2e-3 * 3**0.5
    assert new.rms_m == pytest.approx(float(np.linalg.norm(np.subtract(MOUNTED_M["later"], mean))), rel=0.1)
    assert new.share_in_95[:3].min() == 1.0
    assert predict(own, replace(RUNS[0], run_id="monday again")).std_m < 3e-4


@pytest.mark.slow
def test_a_new_run_scatters_about_the_runs_of_the_fit_not_about_a_stated_place_far_away() -> None:
    away = replace(START, base_translation_m=(0.02, 0.0, -0.01))
    fit = identify(RUNS, away, ["law", *BASE], per_run=["base_translation"], stated=stated_values(away, {}))
    new = predict(fit, run("later"))
    assert new.rms_m < 5e-3
    assert new.share_in_95[:3].min() == 1.0
    assert new.std_m < 6e-3


def test_a_mounting_that_is_not_free_differs_between_the_runs_within_its_prior() -> None:
    stated = {name: Prior(p.mean, 1e-9) for name, p in stated_values(START, {}).items()}
    stated |= {name: Prior(0.0, 3e-3) for name in BASE}
    fit = identify(RUNS, START, ["law"], stated=stated, per_run=["base_translation"])
    held = {(e.name, e.run): e.used for e in fit.estimates if e.nuisance and e.run and e.name in BASE}
    assert set(held) == {(name, day) for name in BASE for day in ("monday", "friday")}
    for (name, day), value in held.items():
        assert value == pytest.approx(MOUNTED_M[day][BASE.index(name)], abs=3e-4)


@pytest.mark.parametrize(
    ("name", "reason"),
    [("basis", "did you mean base"), ("damping_s", "damping_s cannot differ between the runs: it has no effect")],
)
def test_a_name_that_cannot_differ_between_the_runs_is_refused(name: str, reason: str) -> None:
    with pytest.raises(UnknownParameter, match=reason):
        identify(RUNS, START, ["law"], per_run=[name])
