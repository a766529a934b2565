"""Designs that separate two laws, against a general least-squares solver, closed forms and chance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import chi2, norm

from calibration.design.discrimination import RivalLaw, Separation, closest, separation, t_optimal
from calibration.design.information import Unknowns
from calibration.identify import Poses, Prior, Setup, named
from calibration.identify.candidates import candidates
from calibration.identify.simulated_experiments import plan
from calibration.identify.tip_predictor import Predictor
from rig.config.arm_model import model_arm
from rig.config.loader import load

START = Setup(model_arm(load("mock-ideal")))
PRIORS = {"inner_radius_m": Prior(9.5e-3, 5e-4), "base_z_m": Prior(0.0, 2e-3)}
GRID = (0.1, 0.3, 0.5, 0.65)
PLANNED = plan("levels", 1e5 * np.array([[p, q, q] for p in GRID for q in GRID]))


def law(name: str) -> RivalLaw:
    """A law with two nuisance parameters, at the arm that is closest to the rig's."""
    found = next(one for one in candidates(START) if one.name == name)
    unknowns = Unknowns(found.start, named(found.free, 3), named(PRIORS, 3), PRIORS)
    return closest(RivalLaw(name, unknowns, found.free), PLANNED, Predictor(PLANNED)(START))


@pytest.fixture(scope="module")
def laws() -> dict[str, RivalLaw]:
    names = (
        "homogeneous+rpe",
        "inhomogeneous+rpe, pointwise",
        "inhomogeneous+rpe, secant",
        "inhomogeneous+rpe, tangent",
    )
    return {name: law(name) for name in names}


def test_the_closest_arm_of_the_law_of_the_rig_is_the_arm_of_the_rig(laws: dict[str, RivalLaw]) -> None:
    assert laws["inhomogeneous+rpe, pointwise"].unknowns.start == START


def test_the_distance_is_what_a_general_solver_leaves_of_the_difference(laws: dict[str, RivalLaw]) -> None:
    truth, rival = laws["inhomogeneous+rpe, pointwise"], laws["inhomogeneous+rpe, secant"]
    planned = PLANNED.only(np.array([0, 3, 5, 10, 12, 15]))
    planned = replace(planned, pressure_std_pa=np.zeros_like(planned.pressure_std_pa))
    tips = Predictor(planned)(truth.unknowns.start)
    parameters = (*rival.unknowns.free, *rival.unknowns.nuisance)
    predictor = Predictor(planned)
    spans = np.array([one.span(one.read(START)) for one in parameters])
    first = np.array([one.read(rival.unknowns.start) for one in parameters])

    def rows(z: np.ndarray) -> np.ndarray:
        setup = rival.unknowns.start
        for one, value in zip(parameters, (first + spans * z).tolist(), strict=True):
            setup = one.write(setup, value)
        gaps = (tips - predictor(setup)) / np.sqrt(np.diagonal(planned.covariance_m2, axis1=1, axis2=2))
        known = [(one.read(setup) - PRIORS[one.name].mean) / PRIORS[one.name].std for one in rival.unknowns.nuisance]
        return np.concatenate([gaps.ravel(), known])

    solved = least_squares(rows, np.zeros(len(parameters)), xtol=1e-12, ftol=1e-12)
    found = separation(truth, rival, planned)
    assert found.distance2 == pytest.approx(2 * solved.cost, rel=0.02)
    assert found.distance2 > 1


def test_a_rival_that_contains_the_true_law_is_at_no_distance(laws: dict[str, RivalLaw]) -> None:
    found = separation(laws["homogeneous+rpe"], laws["inhomogeneous+rpe, pointwise"], PLANNED)
    assert not found.separable
    assert (found.more, found.at_bound) == (1, 1)
    assert found.share == pytest.approx(0.5 + 0.5 * chi2.cdf(np.log(found.independent) - 2, 1))


def test_the_expected_share_is_that_of_a_normal_likelihood_ratio() -> None:
    far = Separation("a", "b", distance2=12.0, numbers=100_000, independent=1e6, more=0)
    assert far.share == pytest.approx(norm.cdf((12.0 - 2) / 2 / np.sqrt(12.0)), abs=1e-3)
    assert replace(far, more=1).share > far.share > replace(far, more=-1).share
    assert replace(far, distance2=0.0).share == 0.0
    assert far.repeated(4.0).share == pytest.approx(norm.cdf((48.0 - 2) / 2 / np.sqrt(48.0)), abs=1e-3)
    assert replace(far, distance2=0.5, more=1).repeated(100.0).share == pytest.approx(chi2.cdf(np.log(1e8) - 2, 1))
    assert replace(far, distance2=0.0, more=2).share == pytest.approx(chi2.cdf(2 * np.log(1e6) - 2, 2))


@pytest.mark.slow
def test_the_design_separates_better_than_random_ones(laws: dict[str, RivalLaw]) -> None:
    pair = (laws["inhomogeneous+rpe, pointwise"], laws["inhomogeneous+rpe, secant"])
    chosen = t_optimal(pair, PLANNED, 8)
    rng = np.random.default_rng(1)

    def least(indices: np.ndarray) -> float:
        part: Poses = PLANNED.only(indices)
        return min(separation(*pair, part).distance2, separation(*pair[::-1], part).distance2)

    best = least(np.array(chosen))
    assert len(chosen) == 8
    assert all(least(rng.integers(0, len(PLANNED), 8)) < best for _ in range(4))


def test_the_same_poses_are_chosen_each_time(laws: dict[str, RivalLaw]) -> None:
    pair, some = (laws["inhomogeneous+rpe, pointwise"], laws["inhomogeneous+rpe, secant"]), PLANNED.only(np.arange(8))
    assert t_optimal(pair, some, 6) == t_optimal(pair, some, 6)


def test_one_law_in_other_numbers_is_refused(laws: dict[str, RivalLaw]) -> None:
    with pytest.raises(ValueError, match="predict the same ones"):
        t_optimal((laws["inhomogeneous+rpe, secant"], laws["inhomogeneous+rpe, tangent"]), PLANNED, 6)
