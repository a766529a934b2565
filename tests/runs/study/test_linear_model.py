"""Effects of a study: the linear model against known effects and against an independent computation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from runs.study.linear_model import BLOCK, ORDER, TIME, fit


def balanced(seed: int, drift: float = 0.0) -> tuple[dict[str, list[float]], list[int], list[int], np.ndarray]:
    random = np.random.default_rng(seed)
    cells = [(a, b) for a in (1.0, 2.0) for b in (1.0, 2.0, 3.0)]
    rows = [(block, *cells[k]) for block in range(1, 6) for k in random.permutation(6)]
    factors = {"a": [row[1] for row in rows], "b": [row[2] for row in rows]}
    order = list(range(1, 31))
    y = 10 + 3 * np.array(factors["a"]) + drift * np.array(order) / 29 + random.normal(0, 0.1, 30)
    return factors, [row[0] for row in rows], order, y


def test_known_effects_and_drift_are_found_and_absent_ones_are_not() -> None:
    factors, blocks, order, y = balanced(3, drift=2.0)
    model = fit(factors, blocks, order, y)
    effect = next(level for level in model.levels if (level.factor, level.level) == ("a", 2.0))
    assert effect.difference == pytest.approx(3.0, abs=3 * effect.difference_half_width)
    assert 0.02 < effect.difference_half_width < 0.2
    assert model.residual_std == pytest.approx(0.1, rel=0.5)
    p = {test.name: test.p for test in model.tests}
    assert p["a"] < 1e-6
    assert p["b"] > 0.01
    assert p["a x b"] > 0.01


@pytest.mark.slow
def test_a_drift_that_blocks_explain_too_is_found_by_the_joint_test_and_not_where_there_is_none() -> None:
    single = joint = false = 0
    for seed in range(200):
        p = {test.name: test.p for test in fit(*balanced(seed, drift=0.3)).tests}
        single += p[ORDER] < 0.05 or p[BLOCK] < 0.05
        joint += p[TIME] < 0.05
        false += {test.name: test.p for test in fit(*balanced(seed)).tests}[TIME] < 0.05
    assert joint / 200 > 0.75
    assert single < joint
    assert 0.02 <= false / 200 <= 0.08


def test_the_joint_test_of_block_and_order_is_that_of_the_two_nested_models() -> None:
    factors, blocks, order, y = balanced(5, drift=0.3)
    cells = np.array([factors["a"], factors["b"]]).T
    factorial = (cells[:, None] == np.unique(cells, axis=0)[None]).all(axis=2).astype(float)
    time = np.column_stack([(np.array(blocks)[:, None] == np.arange(1, 6)).astype(float), order])
    whole = np.hstack([factorial, time])
    left = [np.sum((y - x @ np.linalg.pinv(x) @ y) ** 2) for x in (factorial, whole)]
    dof = 30 - 6 - 4 - 1
    f = (left[0] - left[1]) / 5 / (left[1] / dof)
    model = fit(factors, blocks, order, y)
    assert next((test.dof, test.f) for test in model.tests if test.name == TIME) == (5, pytest.approx(f))
    between = sum(6 * (np.mean(np.array(order)[np.array(blocks) == b]) - 15.5) ** 2 for b in range(1, 6))
    assert model.shared == pytest.approx(between / np.sum((np.array(order) - 15.5) ** 2))


@pytest.mark.slow
def test_intervals_of_95_percent_hold_in_95_percent_of_studies() -> None:
    held = 0
    for seed in range(400):
        model = fit(*balanced(seed))
        level = next(level for level in model.levels if (level.factor, level.level) == ("a", 2.0))
        held += abs(level.difference - 3.0) <= level.difference_half_width
    assert 0.92 <= held / 400 <= 0.98


def test_one_factor_without_drift_is_the_one_way_analysis_of_variance() -> None:
    random = np.random.default_rng(1)
    levels = [1.0, 2.0, 3.0] * 6
    y = random.normal(0, 1, 18)
    model = fit({"a": levels}, [1] * 18, [1] * 18, y)
    f, p = stats.f_oneway(*(y[np.array(levels) == level] for level in (1.0, 2.0, 3.0)))
    assert (model.tests[0].f, model.tests[0].p) == pytest.approx((f, p))


def test_factors_that_change_together_have_no_effect_of_their_own() -> None:
    levels = [1.0, 2.0] * 5
    y = np.random.default_rng(0).normal(0, 1, 10)
    model = fit({"a": levels, "b": levels}, [1] * 10, list(range(10)), y)
    assert all(np.isnan(level.difference_half_width) for level in model.levels if level.level == 2.0)


def test_without_replicates_there_are_no_error_bars() -> None:
    model = fit({"a": [1.0, 2.0]}, [1, 1], [1, 2], np.array([1.0, 2.0]))
    assert model.residual_dof == 0
    assert all(np.isnan(level.half_width) for level in model.levels)
