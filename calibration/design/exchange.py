"""Choice of experiments by their information: greedy start, then exchange (Fedorov 1972)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from model.arrays import Array
from model.processors import usable_processors

Criterion = Callable[[Array], Array]
"""From covariances (.., m, m) of the parameters of interest to numbers (..) to minimise."""

# Decrease of the criterion below which two designs are equally good.
_EQUAL = 1e-9


def d_optimal(covariance: Array) -> Array:
    """Logarithm of the volume of the confidence ellipsoid, per parameter."""
    out: Array = np.linalg.slogdet(covariance)[1] / (2 * covariance.shape[-1])
    return out


def minimax(covariance: Array) -> Array:
    """Logarithm of the largest standard error, in the units of the covariance."""
    out: Array = np.log(np.diagonal(covariance, axis1=-2, axis2=-1).max(axis=-1)) / 2
    return out


CRITERIA: dict[str, Criterion] = {"d": d_optimal, "minimax": minimax}


def choose(
    information: Array,
    prior: Array,
    count: int,
    interest: Sequence[int],
    criterion: Criterion,
    seed: int = 0,
    restarts: int = 4,
) -> tuple[int, ...]:
    """Indices of `count` of the experiments, sorted; one may be chosen several times.

    information (B, n, n) of each experiment, which adds; prior (n, n), positive definite together with any of them;
    interest: the unknowns that count, the others are nuisance parameters. The best of exchanges from the greedy design
    and from `restarts` random ones.
    """

    def value(total: Array) -> Array:
        part = np.ix_(interest, interest)
        covariance = np.asarray(np.linalg.inv(total), np.float64)
        return criterion(covariance[..., part[0], part[1]])

    def exchanged(chosen: list[int]) -> tuple[float, list[int]]:
        total = prior + information[chosen].sum(axis=0)
        best = float(value(total))
        improved = True
        while improved:
            improved = False
            for place in range(count):
                without = total - information[chosen[place]]
                values = value(without + information)
                new = int(np.argmin(values))
                if values[new] < best - _EQUAL:
                    chosen[place], total, best, improved = new, without + information[new], float(values[new]), True
        return best, chosen

    rng = np.random.default_rng(seed)
    greedy: list[int] = []
    for _ in range(count):
        greedy.append(int(np.argmin(value(prior + information[greedy].sum(axis=0) + information))))
    random = [rng.integers(len(information), size=count).tolist() for _ in range(restarts)]
    # The inversions release the interpreter.
    with ThreadPoolExecutor(max_workers=usable_processors()) as pool:
        found = list(pool.map(exchanged, (greedy, *random)))
    return tuple(sorted(min(found, key=lambda one: one[0])[1]))
