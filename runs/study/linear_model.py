"""Effects of the factors of a study: a linear model by least squares.

response = mean + factors + two-factor interactions + blocks + drift x order + error. Factors and blocks are
categorical, coded to a sum of zero; the order of the runs enters linearly. Tests are F tests of type II: the sum of
squares that a term removes when it joins all others that do not contain it, over the mean square of the residuals of
the whole model. Runs of a block follow each other, so blocks and order explain much of the same change with time, which
the test of each leaves to the other: a joint test of both finds it. Means of levels are those of the model without
interactions, with 95 % intervals by Student's t.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy import stats

from runs.arrays import Array

ORDER, BLOCK, CROSSED = "order of the runs", "block", " x "
TIME = f"{BLOCK} and {ORDER} together"


@dataclass(frozen=True)
class TermTest:
    """One term: degrees of freedom, F and p; NaN where the data cannot separate it or has no replicates."""

    name: str
    dof: int
    f: float
    p: float


@dataclass(frozen=True)
class LevelMean:
    """Adjusted mean of a factor's level, half of its 95 % interval, and the same of its difference to the first."""

    factor: str
    level: float
    mean: float
    half_width: float
    difference: float
    difference_half_width: float


@dataclass(frozen=True)
class LinearModel:
    """Tests, means of levels, change over the whole study by order, and the standard deviation of the residuals.

    `shared` is the part of the variance of the order that lies between the blocks: at 1 they cannot be told apart.
    """

    tests: tuple[TermTest, ...]
    levels: tuple[LevelMean, ...]
    drift: float
    drift_half_width: float
    shared: float
    residual_std: float
    residual_dof: int


@dataclass(frozen=True)
class _Term:
    name: str
    parts: frozenset[str]
    columns: Array


def fit(factors: Mapping[str, Sequence[float]], blocks: Sequence[int], order: Sequence[int], y: Array) -> LinearModel:
    """Fit the model to the responses `y` (n,); factors, blocks and order have one value for each run.

    Factors of one level are left out. Where the model leaves no degree of freedom for the error, widths are NaN.
    """
    n = len(y)
    levels = {name: sorted(set(values)) for name, values in factors.items()}
    coded = {name: _coded(values) for name, values in factors.items() if len(levels[name]) > 1}
    terms = [_Term(name, frozenset({name}), columns) for name, columns in coded.items()]
    if len(set(blocks)) > 1:
        terms.append(_Term(BLOCK, frozenset({BLOCK}), _coded([float(block) for block in blocks])))
    position = np.asarray(order, float)
    spread = float(np.ptp(position)) if n else 0.0
    if spread > 0:
        terms.append(_Term(ORDER, frozenset({ORDER}), ((position - position.mean()) / spread)[:, None]))
    main = list(terms)
    for one, other in combinations(coded, 2):
        columns = (coded[one][:, :, None] * coded[other][:, None, :]).reshape(n, -1)
        terms.append(_Term(f"{one}{CROSSED}{other}", frozenset({one, other}), columns))
    whole = _design(terms, n)
    residual, rank = _residual(whole, y)
    dof = n - rank
    variance = residual / dof if dof > 0 else math.nan
    t = float(stats.t.ppf(0.975, dof)) if dof > 0 else math.nan

    def tested(name: str, *group: _Term) -> TermTest:
        others = [other for other in terms if not any(term.parts <= other.parts for term in group)]
        without, rank_without = _residual(_design(others, n), y)
        with_group, rank_with = _residual(_design([*others, *group], n), y)
        removed = rank_with - rank_without
        f = (without - with_group) / removed / variance if removed and variance > 0 else math.nan
        return TermTest(name, removed, f, float(stats.f.sf(f, removed, dof)) if removed else math.nan)

    tests = [tested(term.name, term) for term in terms]
    in_time = [term for term in main if term.name in (BLOCK, ORDER)]
    shared = 0.0
    if len(in_time) > 1:
        tests.append(tested(TIME, *in_time))
        shared = 1 - _residual(_design(in_time[:1], n), position)[0] / float(np.sum((position - position.mean()) ** 2))

    design = _design(main, n)
    inverse = np.linalg.pinv(design.T @ design)
    beta = inverse @ design.T @ y

    def estimate(contrast: Array) -> tuple[float, float]:
        estimable = np.allclose(contrast @ inverse @ design.T @ design, contrast, atol=1e-8)
        if not estimable:
            return math.nan, math.nan
        return float(contrast @ beta), t * math.sqrt(max(float(contrast @ inverse @ contrast), 0.0) * variance)

    means, start = [], 1
    for name, columns in coded.items():
        rows = [np.eye(design.shape[1])[0] for _ in levels[name]]
        for row, code in zip(rows, _codes(len(levels[name])), strict=True):
            row[start : start + columns.shape[1]] = code
        start += columns.shape[1]
        for level, row in zip(levels[name], rows, strict=True):
            means.append(LevelMean(name, level, *estimate(row), *estimate(row - rows[0])))
    drift = estimate(np.eye(design.shape[1])[-1]) if spread > 0 else (math.nan, math.nan)
    return LinearModel(tuple(tests), tuple(means), *drift, shared, math.sqrt(variance), dof)


def _codes(count: int) -> Array:
    """Codes (count, count - 1) of levels, with a sum of zero."""
    return np.vstack([np.eye(count - 1), -np.ones(count - 1)])


def _coded(values: Sequence[float]) -> Array:
    levels = sorted(set(values))
    return _codes(len(levels))[[levels.index(value) for value in values]]


def _design(terms: Sequence[_Term], n: int) -> Array:
    return np.hstack([np.ones((n, 1)), *(term.columns for term in terms)])


def _residual(design: Array, y: Array) -> tuple[float, int]:
    """Residual sum of squares and rank of a design."""
    beta, _, rank, _ = np.linalg.lstsq(design, y, rcond=1e-10)
    return float(np.sum((y - design @ beta) ** 2)), int(rank)
