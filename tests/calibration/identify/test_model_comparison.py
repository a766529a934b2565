"""Model choice: the model that made the data wins by runs left out, and is only recommended where it pays."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import model
from calibration.identify import NoDataError, Poses, Prior, Setup, identify
from calibration.identify.comparison.candidates import Candidate, candidates
from calibration.identify.comparison.model_comparison import (
    ComparisonRow,
    best_of,
    compare_models,
    compared,
    decision,
    sentence,
)
from calibration.identify.simulated_experiments import MeasurementErrors, perform, plan
from calibration.identify.unknowns.memory_parameters import ALL_NAMES
from model.material import MaxwellBranch

pytestmark = pytest.mark.slow

RAMP = np.linspace(0.15e5, 0.65e5, 6)[:, None]
ERRORS = MeasurementErrors((1e-4, 1e-4, 1e-4), 10.0, 0.0)
START = Setup(model.Arm.paper())


def data(truth: model.Arm) -> list[Poses]:
    rng = np.random.default_rng(3)
    planned = (
        plan("ramp-a", RAMP * np.array([1.0, 0, 0]), errors=ERRORS),
        plan("ramp-b", RAMP * np.array([0, 1.0, 1.0]), errors=ERRORS),
        plan("weights", np.zeros((6, 3)), np.linspace(0, 1.2, 6), errors=ERRORS),
    )
    return [perform(one, Setup(truth), rng, ERRORS) for one in planned]


def some() -> tuple[Candidate, ...]:
    names = ("homogeneous", "homogeneous+rpe", "inhomogeneous+rpe")
    return tuple(c for c in candidates(START) if c.name in names)


def test_an_inhomogeneous_arm_is_recognised_and_the_larger_model_pays() -> None:
    arm = model.Arm.paper()
    choice = compare_models(data(arm.with_segment(material=replace(arm.material, a1_per_n=0.008))), some(), workers=1)
    assert [row.candidate.name for row in choice.rows] == [
        "homogeneous",
        "homogeneous+rpe",
        "inhomogeneous+rpe",
    ]
    assert choice.best.candidate.inhomogeneous
    errors = [row.error_percent for row in choice.rows]
    assert errors[0] > errors[1] > errors[2]
    assert "the data pay for the larger model" in choice.sentence


def test_a_homogeneous_arm_does_not_pay_for_softening() -> None:
    choice = compare_models(data(model.Arm.paper("homogeneous+rpe")), some(), workers=1)
    plain, radial, soft = choice.rows
    assert plain.bic > radial.bic + 10
    assert soft.bic > radial.bic - 10
    assert radial.error_m < 3e-4


def test_the_bic_of_frames_is_that_of_their_means_on_plateaus() -> None:
    ramp, _, weights = data(model.Arm.paper("homogeneous+rpe"))
    means = [replace(one, averaged=np.full(len(one), 4.0)) for one in (ramp, weights)]
    frames = [replace(one, covariance_m2=4 * one.covariance_m2) for one in (ramp, weights)]
    every = [one.only(np.repeat(np.arange(len(one)), 4)) for one in frames]
    _, radial, soft = some()
    gains = [
        identify(runs, soft.start, soft.free).bic - identify(runs, radial.start, radial.free).bic
        for runs in (means, every)
    ]
    assert gains[0] == pytest.approx(gains[1], abs=0.5)


def test_the_conclusion_warns_if_the_bic_prefers_another_model() -> None:
    asked = [c for c in candidates(START) if c.name in ("homogeneous+rpe", "inhomogeneous+rpe")]
    radial, pointwise = compare_models(data(model.Arm.paper()), asked, workers=1).rows
    assert "together better" not in sentence((pointwise, radial), pointwise)
    lucky = replace(radial, error_m=0.5 * pointwise.error_m)
    text = sentence((pointwise, lucky), lucky)
    assert text.startswith("homogeneous+rpe predicts runs left out best")
    assert "inhomogeneous+rpe fits all runs together better (BIC lower by" in text
    nearly = replace(lucky, bic=pointwise.bic + 5)
    assert "together better" not in sentence((pointwise, nearly), nearly)


def test_the_conclusion_names_a_memory_that_predicts_better_but_gains_too_little() -> None:
    one = candidates(START)[0]
    arm = START.arm
    branch = MaxwellBranch(0.1, 1.0)
    memory = replace(
        one, name="branch", start=Setup(arm.with_segment(material=replace(arm.material, branches=(branch,))))
    )
    plain = ComparisonRow(one, 1.0, 1e-3, 0.0, 100.0, 5, None)
    near = ComparisonRow(memory, 1.0, 0.97e-3, 0.0, 100.0, 7, None)
    assert best_of((plain, near)) is plain
    assert "branch predicts them 3 % better, but a memory must gain 5 %." in sentence((plain, near), plain)
    far = replace(near, error_m=0.9e-3)
    assert best_of((plain, far)) is far
    assert "must gain" not in sentence((plain, far), far)


def test_a_single_run_is_compared_by_parts_that_are_left_out() -> None:
    levels = np.array([[p, q, q] for p in (0.1, 0.35, 0.6) for q in (0.1, 0.3, 0.5, 0.65)])[::-1] * 1e5
    truth = Setup(model.Arm.paper())
    run = perform(plan("levels", levels, errors=ERRORS), truth, np.random.default_rng(1), ERRORS)
    steps: list[tuple[int, int]] = []
    found = compare_models([run], some()[1:], workers=1, progress=lambda *at: steps.append(at))
    assert steps[-1] == (12, 12)
    assert found.best.candidate.inhomogeneous
    assert found.best.error_m < 2e-4
    assert "predicts parts of the run left out best" in found.sentence
    assert "Decision: inhomogeneous+rpe; BIC lower by" in found.sentence


def test_two_models_are_decided_by_the_lower_bic_or_not_at_all() -> None:
    one = candidates(START)[0]
    row = ComparisonRow(one, 1.0, 1e-3, 0.0, 100.0, 5, None)
    other = replace(row, candidate=replace(one, name="other"), bic=100 + 2 * np.log(150.0))
    assert decision((other, row)) == ("Decision: homogeneous; BIC lower by 10.0, odds of about 150 to 1 against other.")
    assert decision((row, replace(other, bic=101.0))).startswith("The data do not decide between homogeneous and other")
    assert "more than 1000 to 1" in decision((row, replace(other, bic=9e5)))


def test_an_implausible_number_costs_as_much_as_its_prior_says() -> None:
    run = data(model.Arm.paper())
    free = identify(run, START, ("law", "rpe_per_bar", "base"))
    held = identify(run, START, ("law", "rpe_per_bar", "base"), {"base_x_m": Prior(0.01, 0.001)})
    gap = held["base_x_m"].used - 0.01
    assert held.bic == pytest.approx(free.bic + (gap / 0.001) ** 2, rel=0.05)


def test_an_interrupted_comparison_resumes_from_its_stored_results(tmp_path: Path) -> None:
    made, asked, steps = data(model.Arm.paper()), some()[:1], []

    def stop(done: int, total: int) -> None:
        steps.append((done, total))
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        compare_models(made, asked, workers=1, store=tmp_path, progress=stop)
    kept = {file: file.stat().st_mtime_ns for file in tmp_path.iterdir()}
    resumed = compare_models(made, asked, workers=1, store=tmp_path, progress=lambda *at: steps.append(at))
    assert len(kept) == 2
    assert {file: file.stat().st_mtime_ns for file in kept} == kept
    # One fit to all runs and one without each of three: two before the break, and then from the first kept one on.
    assert steps == [(1, 4), (2, 4), (1, 4), (2, 4), (3, 4), (4, 4)]
    assert resumed == compare_models(made, asked, workers=1)


def test_damping_of_a_held_out_run_does_not_leak_into_its_prediction() -> None:
    arm = model.Arm.paper()
    damped = arm.with_segment(material=replace(arm.material, damping_s=0.06))
    sine = (0.35e5 + 0.15e5 * np.sin(np.arange(60)[:, None] / 5)) * np.array([1.0, 0, 0])
    rng = np.random.default_rng(5)
    moving = perform(plan("sine", sine, period_s=1 / 30, errors=ERRORS), Setup(damped), rng, ERRORS)
    one = Candidate("inhomogeneous", START, ("a1_per_n",)).with_damping()
    found = compare_models([*data(damped)[:1], moving], [one], workers=1).rows[0]
    assert found.damping_s == pytest.approx(0.06, rel=0.05)
    # Without the motion nothing tells the damping: the candidate predicts with what it started from.
    assert found.error_m > 5e-4


def test_long_runs_are_compared_by_a_part_of_their_frames() -> None:
    still, moving = plan("still", np.zeros((1000, 3))), plan("moving", np.zeros((5000, 3)), period_s=1 / 30)
    assert len(compared(still)) == 300
    assert compared(still).time_s[[0, -1]].tolist() == still.time_s[[0, -1]].tolist()
    assert np.array_equal(compared(moving).time_s, moving.time_s[:2000])
    few = plan("few", np.zeros((10, 3)))
    assert compared(few) is few


def test_one_run_is_not_enough() -> None:
    with pytest.raises(NoDataError, match="at least two runs"):
        compare_models(data(model.Arm.paper())[:1], some())


def test_the_candidates_are_the_papers_models_pushes_and_memories() -> None:
    still = candidates(START)
    assert [(c.inhomogeneous, c.radial) for c in still[:3]] == [(False, False), (False, True), (True, True)]
    assert len(still) == 8
    pushes = {c.start.arm.actuation.name for c in still if "push_growth_per_bar" in c.free}
    assert pushes == {"own-pressure", "pressure-sum"}
    assert all(c.start.arm.actuation.name == "proportional" for c in still[:3])
    remembered = [set(c.free) & ALL_NAMES for c in still]
    branch, stop = {"branch_1_modulus", "branch_1_time_s"}, {"stop_1_weight", "stop_1_width_pa"}
    assert remembered == [set()] * 5 + [branch, stop, branch | stop]
    assert [c.start.arm.remembers for c in still] == [False] * 5 + [True] * 3
    assert all("damping_s" not in c.free for c in still)


@pytest.mark.parametrize("free", [(), ("base", "damping_s")])
@pytest.mark.parametrize("damping_s", [0.0, 0.02])
def test_with_moving_runs_every_model_is_compared_with_and_without_damping(
    damping_s: float, free: tuple[str, ...]
) -> None:
    arm = model.Arm.paper()
    start = Setup(arm.with_segment(material=replace(arm.material, damping_s=damping_s)))
    moving = candidates(start, free, moving=True)
    assert [c.name for c in moving[::2]] == [c.name for c in moving[1::2]] == [c.name for c in candidates(start)]
    for without, damped in zip(moving[::2], moving[1::2], strict=True):
        assert (without.damping, damped.damping) == (False, True)
        assert without.start.arm.material.damping_s == 0.0
        assert "damping_s" not in without.free
        assert damped.free.count("damping_s") == 1
