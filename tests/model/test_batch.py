"""Batches and whole motions give what single solves give."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from model import Arm, batch
from model.actuation import PressureSum
from model.batch import motions
from model.dynamics import Dynamics
from model.kernels.axis import equilibria
from model.statics import statics

BAR = 1e5
variants: tuple[str, ...] = ("homogeneous", "homogeneous+rpe", "inhomogeneous+rpe")
GROWING = replace(Arm.paper(), actuation=PressureSum(0.1))


@pytest.mark.parametrize("arm", [*map(Arm.paper, variants), GROWING])
@pytest.mark.parametrize("workers", [1, 2, 3])
def test_a_batch_equals_its_members_solved_one_by_one(arm: Arm, workers: int) -> None:
    p = np.random.default_rng(1).uniform(0, 0.65 * BAR, (7, 3))
    tips = batch.statics(arm, p, workers=workers)
    assert tips.ok.all()
    for row, tip, rotation in zip(p, tips.tip_m, tips.tip_rotation, strict=True):
        single = statics(arm, row)
        assert np.array_equal(tip, single.tip_m)
        assert np.array_equal(rotation, single.tip_rotation)


def test_a_batch_of_parameter_sets_keeps_each_set_to_its_row() -> None:
    arms = [
        replace(Arm.paper(), cap_mass_kg=m).with_segment(material=replace(Arm.paper().material, a1_per_n=a))
        for m, a in ((0.05, 0.0074), (0.1, 0.008), (0.0, 0.006), (0.2, 0.0074))
    ]
    p = np.array([[0.6, 0, 0], [0.3, 0.2, 0], [0, 0, 0.5], [0.1, 0.1, 0.1]]) * BAR
    tips = batch.statics(arms, p, workers=2)
    assert all(np.array_equal(tip, statics(arm, row).tip_m) for tip, arm, row in zip(tips.tip_m, arms, p, strict=True))


def test_a_member_without_equilibrium_is_flagged_and_does_not_affect_the_others() -> None:
    arm = Arm.paper("homogeneous")
    tips = batch.statics(arm, np.array([[0.3 * BAR, 0, 0], [1e12, 0, 0], [0.3 * BAR, 0, 0]]))
    assert tips.ok.tolist() == [True, False, True]
    assert np.isnan(tips.tip_m[1]).all()
    assert np.array_equal(tips.tip_m[0], tips.tip_m[2])


@pytest.mark.parametrize("arm", [Arm.paper(), GROWING])
def test_a_motion_in_one_call_equals_its_single_steps(arm: Arm) -> None:
    p = np.random.default_rng(2).uniform(0, 0.5 * BAR, (12, 3))
    one, many = Dynamics(arm, 0.02), Dynamics(arm, 0.02)
    one.start(p[0])
    many.start(p[0])
    steps = [one.step(row) for row in p[1:]]
    run = many.run(p[1:])
    assert run.ok.all()
    assert np.array_equal(run.tip_m, [shape.tip_m for shape in steps])
    assert np.array_equal(run.tip_rotation, [shape.tip_rotation for shape in steps])
    assert np.array_equal(many.step(p[0]).tip_m, one.step(p[0]).tip_m)


def test_a_motion_flags_a_failed_step_and_continues() -> None:
    dynamics = Dynamics(Arm.paper("homogeneous"), 0.02)
    dynamics.start((0, 0, 0))
    run = dynamics.run([(0, 0, 0), (1e12, -1e12, 0), (0, 0, 0)])
    assert run.ok.tolist() == [True, False, True]
    assert np.array_equal(run.tip_m[1], run.tip_m[0])


@pytest.mark.parametrize("arm", [Arm.paper("homogeneous+rpe"), GROWING])
def test_a_batch_of_motions_equals_its_members(arm: Arm) -> None:
    p = np.random.default_rng(3).uniform(0, 0.5 * BAR, (3, 6, 3))
    for path, found in zip(p, motions(arm, p, 1 / 30, workers=2), strict=True):
        dynamics = Dynamics(arm, 1 / 30)
        dynamics.start(path[0])
        assert np.array_equal(found.tip_m, dynamics.run(path[1:]).tip_m)


@pytest.mark.parametrize(
    ("arms", "pressure", "message"),
    [
        ([], [[0, 0, 0]], "no arm"),
        (Arm.paper(), [0, 0, 0], "axes"),
        (Arm.paper(), [[0, 0]], "last of 3"),
        (Arm.paper(), [[0, 0, np.nan]], "finite"),
        ([Arm.paper()] * 2, [[0, 0, 0]] * 3, "2 arms for 3"),
        ([Arm.paper(), Arm.paper("homogeneous")], [[0, 0, 0]] * 2, "share"),
    ],
)
def test_a_batch_that_does_not_fit_together_is_refused(arms: object, pressure: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        batch.statics(arms, pressure)  # type: ignore[arg-type]


def test_rows_in_any_order_in_memory_need_no_kernel_of_their_own() -> None:
    rows = np.array([[0.1e5, 0.2e5, 0.3e5], [0.4e5, 0.0, 0.2e5]])
    expected = batch.statics(Arm.paper(), rows)
    compiled = list(equilibria.signatures)
    found = batch.statics(Arm.paper(), np.asfortranarray(rows))
    assert equilibria.signatures == compiled
    np.testing.assert_array_equal(found.tip_m, expected.tip_m)
