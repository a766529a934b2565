"""The posterior of the model error equals closed forms, enumeration and what was put into simulated arms."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import halfnorm, multivariate_normal

import model
from calibration.identify import Fit, Prior, Setup, identify, named
from calibration.identify.findings import findings
from calibration.identify.information import covariance as covariance_of
from calibration.identify.least_squares import LeastSquaresProblem
from calibration.identify.likelihood import Discrepancy
from calibration.identify.model_error import TERMS, CoefficientPrior, error_inputs
from calibration.identify.model_error_posterior import effect_columns, linearisation_error, normal_equations
from calibration.identify.model_error_sampler import (
    PRESENT,
    AmplitudeSampler,
    NormalEquations,
    coefficients_given,
    log_evidence,
)
from calibration.identify.nuisance import stated_values
from calibration.identify.poses import Poses
from calibration.identify.simulated_experiments import MeasurementErrors, drawn_setup, perform, plan
from calibration.identify.tip_predictor import Predictor
from model.arrays import Array

ERRORS = MeasurementErrors((1e-4, 1e-4, 1e-4), 0.0, 0.0)
START = Setup(model.Arm.paper())
RAMP = np.linspace(0.15e5, 0.65e5, 5)[:, None]
NOISE_M = 3e-5
# Of the ridge that keeps unknowns without data finite: one over the square of five spans.
RIDGE = 1 / 25


def effect_slopes(poses: Poses, setup: Setup) -> Array:
    """Derivatives of the predictions of some poses by the coefficients of the model error, at zero."""
    inputs = error_inputs(poses, 0.65e5, TERMS)
    return inputs.slopes(Predictor(poses), setup, np.zeros(len(inputs.load)))


def linear_problem() -> tuple[NormalEquations, Array, Array, Array, Array]:
    """The normal equations of a small fit, and the whitened residual, Jacobian, columns and prior covariance."""
    planned = [plan("one", RAMP * [1, 0, 0], errors=ERRORS), plan("two", RAMP * [0, 1, 1], errors=ERRORS)]
    data = [perform(one, START, np.random.default_rng(3), ERRORS) for one in planned]
    priors = {"rpe_per_bar": Prior(0.05, 0.01)}
    problem = LeastSquaresProblem(data, START, named(("a1_per_n", "rpe_per_bar", "base_x_m"), 3), priors)
    solution = problem.solve(np.zeros(3), [])
    columns = [effect_slopes(one, problem.setup(solution.z, run))[:, :, :12] for run, one in enumerate(data)]
    root = 1 / np.sqrt(1e-8 + NOISE_M**2)
    predicted, slopes = problem.predicted(solution.z), problem.slopes(solution.z, range(3))
    residual = np.concatenate([(one.tip_m - p).ravel() for one, p in zip(data, predicted, strict=True)]) * root
    jacobian = np.concatenate([s.reshape(-1, 3) for s in slopes]) * root
    effect = np.concatenate([c.reshape(-1, 12) for c in columns]) * root
    rows, gap = problem.prior_rows(solution.z)
    prior = np.linalg.inv(rows.T @ rows + RIDGE * np.eye(3))
    # The prior's mean, seen from the solution.
    residual = residual + jacobian @ (prior @ (rows.T @ gap))
    return (
        normal_equations(problem, solution, np.zeros(len(solution.z)), columns, Discrepancy(NOISE_M)),
        residual,
        jacobian,
        effect,
        prior,
    )


def test_the_evidence_is_the_marginal_likelihood_of_a_linear_gaussian_model() -> None:
    equations, residual, jacobian, effect, prior = linear_problem()
    rng = np.random.default_rng(0)
    deviations = np.abs(rng.standard_normal((6, 12))) * 0.05
    means = rng.standard_normal((6, 12)) * 0.01
    deviations[0] = means[0] = means[1] = 0.0
    without = np.eye(len(residual)) + jacobian @ prior @ jacobian.T
    dense = [
        multivariate_normal.logpdf(residual, effect @ mean, without + (effect * std**2) @ effect.T)
        for std, mean in zip(deviations, means, strict=True)
    ]
    found = np.array([log_evidence(equations, std, mean) for std, mean in zip(deviations, means, strict=True)])
    assert found - found[0] == pytest.approx(np.array(dense) - dense[0], abs=1e-6)
    assert np.ptp(dense) > 1.0


def test_coefficients_and_unknowns_have_the_posterior_of_a_linear_gaussian_model() -> None:
    equations, residual, jacobian, effect, prior = linear_problem()
    deviation, expected = np.linspace(0.01, 0.06, 12), np.linspace(-0.02, 0.03, 12)
    mean, root = coefficients_given(equations, deviation, expected)
    covariance = root @ root.T
    both = np.concatenate([jacobian, effect], axis=1)
    inverse = np.zeros((15, 15))
    inverse[:3, :3] = np.linalg.inv(prior)
    inverse[3:, 3:] = np.diag(1 / deviation**2)
    posterior = np.linalg.inv(both.T @ both + inverse)
    about = np.concatenate([np.zeros(3), expected])
    assert covariance == pytest.approx(posterior[3:, 3:], rel=1e-6, abs=1e-10)
    assert mean == pytest.approx((posterior @ (both.T @ residual + inverse @ about))[3:], rel=1e-6, abs=1e-9)
    crossed = -equations.absorbed @ covariance
    assert crossed == pytest.approx(posterior[:3, 3:], rel=1e-5, abs=1e-9)
    assert equations.inverse - crossed @ equations.absorbed.T == pytest.approx(posterior[:3, :3], rel=1e-5, abs=1e-9)


def test_the_error_of_the_linearisation_is_zero_at_the_solution_and_grows_with_the_square_of_the_change() -> None:
    planned = plan("mixed", np.random.default_rng(4).uniform(0.1e5, 0.6e5, (6, 3)), errors=ERRORS)
    data = [perform(planned, START, np.random.default_rng(3), ERRORS)]
    problem = LeastSquaresProblem(data, START, named(("a1_per_n", "base_x_m"), 3), {})
    solution = problem.solve(np.zeros(2), [])
    columns, prior = effect_columns(problem, solution.z)
    gain = np.zeros(2 + len(prior.term))
    gain[2:][prior.term == 0] = [1.0, 0.0, 0.0, 0.0]
    found = [
        linearisation_error(problem, solution, columns, size * gain, Discrepancy(0.0)) for size in (0.0, 0.02, 0.04)
    ]
    assert found[0] == pytest.approx(0.0, abs=1e-6)
    assert found[2] / found[1] == pytest.approx(4.0, rel=0.1)
    # The arm itself, pushed by the first actuator with 4 % / sqrt(2) more.
    pushed = replace(data[0], pressure_pa=data[0].pressure_pa * [1 + 0.04 / 2**0.5, 1.0, 1.0])
    setup = problem.setup(solution.z, 0)
    linear = Predictor(data[0])(setup) + columns[0] @ (0.04 * gain[2:])
    error = (Predictor(pushed)(setup) - linear) / 1e-4
    assert found[2] == pytest.approx(float(np.sqrt((error**2).mean())), rel=1e-3)


@pytest.mark.slow
def test_noise_is_no_smaller_than_the_error_of_the_linearisation() -> None:
    """The effects explain the residuals of very unequal actuators to a few micrometres, but only when linearised."""
    fit = identified((1.25, 1.0, 0.8))
    assert fit.model_error is not None
    assert fit.discrepancy_m > 1e-3
    assert fit.model_error.noise_m > 0.25 * fit.discrepancy_m


def synthetic(seed: int, noise: float) -> NormalEquations:
    """Normal equations of one unknown and of three coefficients, from made-up rows with independent errors."""
    rng = np.random.default_rng(seed)
    jacobian, effect = rng.standard_normal((30, 1)) / noise, rng.standard_normal((30, 3)) / noise
    residual = effect @ np.array([0.5, -0.3, 0.02]) + rng.standard_normal(30) / noise
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    absorbed, at_fit = inverse @ (jacobian.T @ effect), inverse @ (jacobian.T @ residual)
    constant = 0.5 * float((jacobian.T @ residual) @ at_fit) - 0.5 * float(residual @ residual) - 30 * np.log(noise)
    return NormalEquations(
        inverse,
        at_fit,
        absorbed,
        effect.T @ effect - effect.T @ jacobian @ absorbed,
        effect.T @ residual - effect.T @ jacobian @ at_fit,
        constant,
    )


def test_samples_agree_with_the_enumeration_of_all_amplitudes_and_noises() -> None:
    equations = [synthetic(1, noise) for noise in (1.0, 1.5)]
    scale, prior = np.array([0.3, 0.2]), CoefficientPrior(np.array([0, 0, 1]), np.array([0.0, 0.0, 0.8]), np.ones(3))
    levels = np.concatenate([[0.0], halfnorm.ppf((np.arange(6) + 0.5) / 6)])
    chance = np.concatenate([[1 - PRESENT], np.full(6, PRESENT / 6)])

    def evidence(one: NormalEquations, amplitude: Array) -> float:
        return log_evidence(one, amplitude * prior.std, amplitude * prior.mean)

    total, present, absent, second, first_noise = 0.0, np.zeros(2), 0.0, np.zeros((4, 4)), 0.0
    biggest = max(evidence(one, np.array([0.3, 0.3, 0.0])) for one in equations)
    for k, (i, j) in itertools.product(range(2), itertools.product(range(7), repeat=2)):
        amplitude = np.array([scale[0] * levels[i]] * 2 + [scale[1] * levels[j]])
        weight = chance[i] * chance[j] * np.exp(evidence(equations[k], amplitude) - biggest)
        mean, root = coefficients_given(equations[k], amplitude * prior.std, amplitude * prior.mean)
        covariance = root @ root.T
        u, a = equations[k].at_fit, equations[k].absorbed
        onto = np.concatenate([-a, np.eye(3)])
        centre = np.concatenate([u - a @ mean, mean])
        square = np.outer(centre, centre) + onto @ covariance @ onto.T
        square[:1, :1] += equations[k].inverse
        total += weight
        present += weight * np.array([i > 0, j > 0])
        absent += weight * (i == j == 0)
        first_noise += weight * (k == 0)
        second += weight * square
    found = AmplitudeSampler(equations, prior, scale, sweeps=3000).sample()
    assert 0.2 < present[1] / total < 0.8
    assert found.probability == pytest.approx(present / total, abs=0.02)
    assert found.absent == pytest.approx(absent / total, abs=0.01)
    assert (found.noise == 0).mean() == pytest.approx(first_noise / total, abs=0.05)
    assert found.second == pytest.approx(second / total, rel=0.05, abs=0.002)
    drawn = found.coefficients.T @ found.coefficients / len(found.coefficients)
    assert drawn == pytest.approx(second[1:, 1:] / total, rel=0.05, abs=0.004)


def test_samples_for_another_gradient_are_those_of_equations_with_that_gradient() -> None:
    equations = [synthetic(1, noise) for noise in (1.0, 1.5)]
    scale, prior = np.array([0.3, 0.2]), CoefficientPrior(np.array([0, 0, 1]), np.array([0.0, 0.0, 0.8]), np.ones(3))
    gradients = [synthetic(2, noise).gradient for noise in (1.0, 1.5)]
    sampler = AmplitudeSampler(equations, prior, scale)
    first = sampler.sample()
    changed = sampler.sample(gradients)
    own = [replace(one, gradient=gradient) for one, gradient in zip(equations, gradients, strict=True)]
    expected = AmplitudeSampler(own, prior, scale).sample()
    assert (changed.coefficients == expected.coefficients).all()
    assert (changed.second == expected.second).all()
    assert np.abs(changed.second - first.second).max() > 1e-3


def test_effects_of_dissipation_have_their_sign_and_their_amplitude_in_the_prior_and_others_have_no_sign() -> None:
    poses = plan("one", RAMP * [1, 1, 1], errors=ERRORS)
    signs = {term.name: term.sign for term in TERMS if term.sign}
    assert signs == {"direction": -1, "time since step": -1, "softening": 1}
    rng = np.random.default_rng(0)
    for term in TERMS:
        prior = error_inputs(poses, 0.65e5, [term]).prior
        drawn = prior.mean + prior.std * rng.standard_normal((20_000, len(prior.mean)))
        groups = term.groups(drawn, 3) if term.push else drawn[:, None]
        of_each = (groups[:, :, :-1] + groups[:, :, -1:]).sum(axis=1) / np.sqrt(2) if term.push else drawn
        mean, square = of_each.mean(axis=0), (of_each**2).mean(axis=0)
        assert square == pytest.approx(np.full(square.shape, groups.shape[1]), rel=0.05)
        assert mean / np.sqrt(square) == pytest.approx(np.full(mean.shape, term.sign * halfnorm.mean()), abs=0.05)
    # Creep makes the push lag behind a rising pressure.
    rising = error_inputs(poses, 0.65e5, [term for term in TERMS if term.name == "time since step"])
    assert (rising.push_pa @ rising.prior.mean < 0).all()


@cache
def identified(gains: tuple[float, float, float]) -> Fit:
    """The fit to an arm whose actuators push with these factors."""
    rng = np.random.default_rng(5)
    planned = [
        plan("weights", np.zeros((6, 3)), np.linspace(0, 1.2, 6), errors=ERRORS),
        plan("mixed", rng.uniform(0.05e5, 0.65e5, (24, 3)), errors=ERRORS),
    ]
    stated = stated_values(START, {"sensor_gains": 1e-4, "actuator_angles": 1e-3})
    arm = drawn_setup(START, stated, rng)
    data: list[Poses] = [perform(one, arm, rng, ERRORS, felt_pa=one.pressure_pa * np.array(gains)) for one in planned]
    return identify(data, START, ("law", "rpe_per_bar", "base"), stated=stated)


@pytest.mark.slow
def test_unequal_actuators_are_found_with_their_size_and_nothing_is_found_in_an_arm_that_obeys_the_model() -> None:
    unequal, ideal = identified((1.0, 1.06, 0.95)).model_error, identified((1.0, 1.0, 1.0)).model_error
    assert unequal is not None
    assert ideal is not None
    assert [one.term.name for one in unequal.found] == ["gain"]
    # Relative to the law, which is free, the gains are (0, +6, -5) % about their mean.
    assert unequal.effects[0].mean == pytest.approx(0.045, abs=0.015)
    assert unequal.absent < 1e-3
    assert ideal.found == ()
    # Stated numbers cannot be less certain after the fit, unless errors of the model moved them.
    assert identified((1.0, 1.0, 1.0)).less_certain == ()
    assert "circle_radius_m" in [one.name for one in identified((1.0, 1.06, 0.95)).less_certain]
    assert ideal.effects[0].below < 0.03


@pytest.mark.slow
def test_effects_that_are_found_are_named_with_their_size_and_make_the_parameters_effective_ones() -> None:
    found = findings(identified((1.0, 1.06, 0.95)), ())
    assert re.match(
        r"The arm does what the model does not contain: unequal actuators, \d\.\d\(\d+\) %\.", found.effective
    )
    assert "These parameters are effective ones" in found.effective
    assert found.range_note == ""
    assert findings(identified((1.0, 1.0, 1.0)), ()).effective == ""


@pytest.mark.slow
def test_error_bars_hold_for_an_arm_with_coupled_chambers_that_single_combinations_do_not_reveal() -> None:
    rng, errors = np.random.default_rng(1), MeasurementErrors((3e-5, 3e-5, 6e-5), 20.0, 0.0)
    planned = [
        plan("weights", np.zeros((13, 3)), np.linspace(0, 1.2, 13), errors=errors),
        plan("one", np.linspace(0.15e5, 0.65e5, 11)[:, None] * [1, 0, 0], errors=errors),
        plan("two", np.linspace(0.15e5, 0.65e5, 11)[:, None] * [0, 1, 1], errors=errors),
    ]
    stated = stated_values(START, {})
    arm = drawn_setup(START, stated, rng)
    coupling = np.full((3, 3), 0.05) + 0.95 * np.eye(3)
    data = [perform(one, arm, rng, errors, felt_pa=one.pressure_pa @ coupling) for one in planned]
    fit = identify(data, START, ("law", "rpe_per_bar", "cap_mass_kg", "base"), stated=stated)
    without = np.sqrt(np.diagonal(covariance_of(fit.solution.information))) * fit.problem.rates(fit.solution.z)
    errors_z = np.array([(e.used - named([e.name], 3)[0].read(arm)) for e in fit.estimates])
    free = np.array([e.identified and not e.nuisance for e in fit.estimates])
    assert free.sum() == 9
    assert np.abs(errors_z[free] / without[free]).max() > 4.0
    assert np.abs(errors_z[free] / np.array(fit.std)[free]).max() < 2.6


def test_a_single_ramp_that_leaves_most_parameters_open_has_a_posterior() -> None:
    # The columns of the parameters are then nearly dependent: products of them have lost the digits that matter here.
    rng, errors = np.random.default_rng(2), MeasurementErrors((3e-5, 3e-5, 6e-5), 20.0, 0.0)
    planned = plan("one", np.linspace(0.0, 0.65e5, 12)[:, None] * [1, 0, 0], errors=errors)
    stated = stated_values(START, {})
    data = [perform(planned, drawn_setup(START, stated, rng), rng, errors)]
    fit = identify(data, START, ("law", "rpe_per_bar", "base"), stated=stated)
    columns = [effect_slopes(one, START) for one in data]
    for noise_m in (0.0, NOISE_M):
        seen = normal_equations(
            fit.problem, fit.solution, np.zeros(len(fit.solution.z)), columns, Discrepancy(noise_m)
        ).seen
        values = np.linalg.eigvalsh(seen)
        assert seen == pytest.approx(seen.T, rel=1e-9, abs=1e-9 * values[-1])
        assert values[0] > -1e-9 * values[-1]


def test_the_size_of_an_effect_is_the_root_mean_square_over_actuators_or_pairs() -> None:
    by_name = {one.name: one for one in TERMS}
    own = np.array([[0.03, -0.01, 0.0, 0.02]]) * np.sqrt(2.0)
    assert by_name["gain"].size(own, 3) == pytest.approx(np.sqrt((0.05**2 + 0.01**2 + 0.02**2) / 3))
    common = np.array([[0.0] * 6 + [0.05]]) * np.sqrt(2.0)
    assert by_name["coupling"].size(common, 3) == pytest.approx(0.05)
    # Creep: the sum over its retardation times.
    branches = np.tile(np.array([[0.0, 0.0, 0.0, 0.01]]) * np.sqrt(2.0), (1, 3))
    assert by_name["time since step"].size(branches, 3) == pytest.approx(0.03)
    assert by_name["load"].size(np.array([[-0.02]]), 3) == pytest.approx(0.02)
