"""The fit with the effects that the model lacks: exact predictions, their slopes, and the minimum."""

from __future__ import annotations

import numpy as np
import pytest

import model
from calibration.identify import Setup
from calibration.identify.effects_problem import EffectsProblem
from calibration.identify.least_squares import LeastSquaresProblem
from calibration.identify.model_error import TERMS, error_inputs
from calibration.identify.nuisance import stated_values
from calibration.identify.parameters import named
from calibration.identify.poses import Poses
from calibration.identify.simulated_experiments import MeasurementErrors, perform, plan
from calibration.identify.tip_predictor import Predictor
from model.arrays import Array

START = Setup(model.Arm.paper())
ERRORS = MeasurementErrors((3e-5, 3e-5, 3e-5), 20.0, 100.0)
BAR = np.linspace(0.15, 0.65, 11)[:, None] * np.array([1.0, 0, 0])
GROWN_BAR = BAR * (1 + 0.12 * BAR)
# Information of the ridge term of the search, which keeps undetermined unknowns near their start.
RIDGE = 1 / 25
FREE = ("a1_per_n", "a2_per_n2", "rpe_per_bar", "base_x_m", "base_z_m", "sensor_1_gain")


SINE_BAR = np.column_stack([0.3 + 0.2 * np.sin(np.linspace(0.0, 4 * np.pi, 41)), np.zeros(41), np.full(41, 0.2)])
SINE_HZ = 1.5


def of_coefficients(poses: Poses) -> EffectsProblem:
    """The problem of the unknowns and of the effects of some poses."""
    stated = stated_values(START, {})
    problem = LeastSquaresProblem([poses], START, named(FREE, 3), {"sensor_1_gain": stated["sensor_1_gain"]})
    coefficients = len(error_inputs(poses, 1e5, TERMS).load)
    return EffectsProblem(problem, np.full(coefficients, 0.03))


def effects_problem(seed: int) -> EffectsProblem:
    """A ramp with weights of an arm whose push grows with the pressure."""
    planned = plan("ramp-a", 1e5 * BAR, np.where(np.arange(len(BAR)) % 2, 0.02, 0.0), errors=ERRORS)
    return of_coefficients(perform(planned, START, np.random.default_rng(seed), ERRORS, felt_pa=1e5 * GROWN_BAR))


def moving_effects_problem(seed: int) -> EffectsProblem:
    """A loaded arm that one chamber moves by a sine and another one holds aside."""
    period_s = 2 / (SINE_HZ * (len(SINE_BAR) - 1))
    planned = plan("sine", 1e5 * SINE_BAR, np.full(len(SINE_BAR), 0.02), period_s, ERRORS)
    return of_coefficients(perform(planned, START, np.random.default_rng(seed), ERRORS))


def point_of(problem: EffectsProblem) -> Array:
    """A point at which unknowns and coefficients are not zero."""
    n, rng = len(problem.unknowns), np.random.default_rng(2)
    z = problem.extended(0.2 * rng.standard_normal(n))
    z[n:] = 0.03 * rng.standard_normal(len(z) - n)
    return z


def test_slopes_are_the_derivatives_of_the_predictions() -> None:
    problem = effects_problem(1)
    z = point_of(problem)
    slopes = problem.slopes(z, range(len(z)))[0]
    for i in range(len(z)):
        step = 1e-5 * np.eye(len(z))[i]
        by_difference = (problem.gaps(z - step)[0] - problem.gaps(z + step)[0]) / 2e-5
        assert slopes[:, :, i] == pytest.approx(by_difference, rel=2e-3, abs=2e-7), i


def test_slopes_of_a_motion_have_the_lag_of_the_arm_behind_its_pressures() -> None:
    problem = moving_effects_problem(1)
    z = point_of(problem)
    slopes = problem.slopes(z, range(len(z)))[0]
    differentiated = 0
    for i in range(len(z)):
        step = 1e-5 * np.eye(len(z))[i]
        by_difference = (problem.gaps(z - step)[0] - problem.gaps(z + step)[0]) / 2e-5
        size = np.abs(by_difference).max()
        assert np.abs(slopes[:, :, i] - by_difference).max() <= 3e-3 * size + 1e-7, i
        differentiated += size > 1e-5
    assert differentiated > 20


def test_the_minimum_does_not_depend_on_where_the_search_begins() -> None:
    problem = effects_problem(3)
    n = len(problem.unknowns)
    ends = [problem.solve(problem.extended(z)) for z in (np.zeros(n), np.full(n, 0.3))]
    assert all(one.solved for one in ends)
    std = np.sqrt(np.diagonal(np.linalg.inv(ends[0].information + RIDGE * np.eye(len(ends[0].z)))))
    assert (np.abs(ends[0].z - ends[1].z) < 0.1 * std).all()
    assert problem.deviance(ends[1], ends[0].correlation) == pytest.approx(
        problem.deviance(ends[0], ends[0].correlation), abs=0.1
    )


def test_no_point_near_the_minimum_has_a_smaller_sum_of_squares() -> None:
    problem, rng = effects_problem(3), np.random.default_rng(4)
    found = problem.solve(problem.extended(np.zeros(len(problem.unknowns))))
    at_minimum = problem.loss(found.z, found.weights, found.correlation)
    for _ in range(20):
        near = found.z + 0.02 * rng.standard_normal(len(found.z))
        ridge = RIDGE * float(near @ near - found.z @ found.z)
        assert problem.loss(near, found.weights, found.correlation) + ridge > at_minimum - 1e-3


def test_slopes_of_a_motion_do_not_depend_on_the_order_of_the_terms() -> None:
    problem = moving_effects_problem(1)
    (poses,) = problem.data
    predictor = Predictor(poses)
    columns = []
    for terms in (TERMS, TERMS[::-1]):
        inputs = error_inputs(poses, 1e5, terms)
        slopes = inputs.slopes(predictor, START, np.zeros(len(inputs.load)))
        columns.append([slopes[:, :, inputs.prior.term == k] for k in range(len(terms))])
    for own, again in zip(columns[0], columns[1][::-1], strict=True):
        assert again == pytest.approx(own, rel=1e-6, abs=1e-12)
