"""The exchange algorithm against optima that are known otherwise."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from calibration.design.exchange import CRITERIA, choose, d_optimal, minimax


def line(levels: list[float]) -> np.ndarray:
    """Information of one measurement of a + b x at each level x."""
    rows = np.array([[1.0, x] for x in levels])
    return np.einsum("ki,kj->kij", rows, rows)


def test_a_straight_line_is_measured_at_both_ends() -> None:
    chosen = choose(line([-1.0, -0.5, 0.0, 0.5, 1.0]), 1e-9 * np.eye(2), 6, [0, 1], d_optimal)
    assert chosen == (0, 0, 0, 4, 4, 4)


def test_a_parabola_is_measured_at_both_ends_and_in_the_middle() -> None:
    rows = np.array([[1.0, x, x * x] for x in np.linspace(-1, 1, 9)])
    chosen = choose(np.einsum("ki,kj->kij", rows, rows), 1e-9 * np.eye(3), 9, [0, 1, 2], d_optimal)
    assert chosen == (0, 0, 0, 4, 4, 4, 8, 8, 8)


def test_a_slope_alone_does_not_need_equal_shares_of_a_stated_offset() -> None:
    """With the offset known, only the far level counts."""
    chosen = choose(line([0.0, 0.5, 2.0]), np.diag([1e12, 1e-9]), 4, [1], minimax)
    assert chosen == (2, 2, 2, 2)


@pytest.mark.parametrize("criterion", CRITERIA)
@pytest.mark.parametrize("seed", range(5))
def test_no_design_of_random_experiments_is_better(criterion: str, seed: int) -> None:
    rows = np.random.default_rng(seed).normal(size=(7, 2, 3))
    information, prior = np.einsum("bki,bkj->bij", rows, rows), 1e-3 * np.eye(3)

    def value(chosen: tuple[int, ...]) -> float:
        covariance = np.linalg.inv(prior + information[list(chosen)].sum(axis=0))[:2, :2]
        return float(CRITERIA[criterion](covariance))

    best = min(value(chosen) for chosen in itertools.combinations_with_replacement(range(7), 4))
    assert value(choose(information, prior, 4, [0, 1], CRITERIA[criterion], seed)) == pytest.approx(best, abs=0.02)


def test_the_same_seed_gives_the_same_design() -> None:
    rows = np.random.default_rng(3).normal(size=(20, 2, 4))
    information = np.einsum("bki,bkj->bij", rows, rows)
    designs = {choose(information, 1e-3 * np.eye(4), 5, [0, 1], d_optimal, seed=9) for _ in range(3)}
    assert len(designs) == 1
