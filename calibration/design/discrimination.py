"""T-optimal experiments, which separate two laws (Atkinson and Fedorov 1975): what the best fit of the rival leaves.

Each law predicts the tips with its own free and nuisance parameters. Whitened by the errors of measurement, the
difference of the predictions is a vector. What of it no change of the rival's parameters explains, priors included, has
a squared length that is the noncentrality of the likelihood ratio test. A design maximises the smaller one of the two
cases, either law true.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.stats import binom, chi2, norm

from calibration.design.exchange import choose, minimax
from calibration.design.information import Unknowns
from calibration.identify.least_squares import LeastSquaresProblem
from calibration.identify.model_comparison import MIN_DECISIVE
from calibration.identify.poses import Poses
from calibration.identify.tip_predictor import Predictor
from model.arrays import Array

# A smaller squared distance, in variances, does not separate laws: the rival contains the true law, or nearly so.
_ALIKE = 1.0
# Weak information of each unknown, in squared spans, as in a fit.
_RIDGE = 1 / 25.0
_ROUNDS = 4


@dataclass(frozen=True)
class RivalLaw:
    """A law in a comparison: its name, what a fit of it estimates, and the true arm of it that the design assumes.

    own: names of the parameters that belong to the law alone.
    """

    name: str
    unknowns: Unknowns
    own: tuple[str, ...]


@dataclass(frozen=True)
class Separation:
    """What is left between a true law and the best fit of its rival, in a planned experiment.

    distance2: squared distance in variances, priors included. numbers: measured ones; independent: the same in frames,
    the sample size of the BIC. more: parameters of the rival beyond those of the true law. at_bound: parameters of the
    rival that its best fit has at a bound.
    """

    truth: str
    rival: str
    distance2: float
    numbers: int
    independent: float
    more: int
    at_bound: int = 0

    @property
    def separable(self) -> bool:
        """Whether the tips of the true law differ from those of every arm of the rival."""
        return self.distance2 > _ALIKE

    @property
    def share(self) -> float:
        """Expected share of decisions for the true law: its BIC is lower by `MIN_DECISIVE`; else nothing is decided.

        The rival's fit takes its distance for a larger error. Where the rival contains the true law, only the penalty
        of its additional parameters decides, against a chi-squared variable; of a parameter at a bound half the errors
        have no effect (Self and Liang 1987). Then the share is an upper bound: of a number that the data hardly
        determine, the fit takes what suits the errors.
        """
        penalty = self.more * float(np.log(self.independent))
        if not self.separable:
            if self.more <= 0:
                return 0.0
            halved = min(self.at_bound, self.more)
            mixed = np.array([binom.pmf(k, halved, 0.5) for k in range(halved + 1)])
            freedom = self.more - halved + np.arange(halved + 1)
            return float(mixed @ np.where(freedom > 0, chi2.cdf(penalty - MIN_DECISIVE, np.maximum(freedom, 1)), 1.0))
        seen = self.numbers * float(np.log1p(self.distance2 / self.numbers))
        return float(norm.cdf((seen + penalty - MIN_DECISIVE) / (2 * np.sqrt(seen))))

    def repeated(self, count: float) -> Separation:
        """The separation by so many repeats of the experiment, about: the priors count again with each."""
        return replace(
            self,
            distance2=self.distance2 * (count if self.separable else 1.0),
            numbers=round(self.numbers * count),
            independent=self.independent * count,
        )


def closest(law: RivalLaw, planned: Poses, tip_m: Array) -> RivalLaw:
    """The law with those values of its own parameters that bring its tips closest to given ones (K, 3)."""
    problem = _problem(law.unknowns, replace(planned, tip_m=tip_m))
    others = [i for i, one in enumerate(problem.unknowns) if one.parameter.name not in law.own]
    found = problem.solve(np.zeros(len(problem.unknowns)), others)
    return replace(law, unknowns=replace(law.unknowns, start=problem.setup(found.z, 0)))


def separation(truth: RivalLaw, rival: RivalLaw, planned: Poses) -> Separation:
    """How well a planned experiment of one run separates a true law from its rival."""
    return _separation(truth, rival, planned, _fitted(truth, rival, planned))


def t_optimal(laws: Sequence[RivalLaw], planned: Poses, count: int, seed: int = 0) -> tuple[int, ...]:
    """Indices of `count` of the planned poses, sorted, some repeated: the smaller distance of the two laws is largest.

    The exchange algorithm needs an information that adds. So the rival's predictions are linear in its parameters, at
    its best fit; the fit to the chosen poses then takes the place of the former one, until the distance no longer grows
    (Atkinson and Fedorov 1975). A case that no poses separate, because the rival contains the true law, does not count.

    Raises:
        ValueError: the laws predict the same tips: one is the other in other numbers.
    """
    first, second = laws
    cases = [(first, second), (second, first)]
    fits = [_fitted(truth, rival, planned) for truth, rival in cases]
    kept = [k for k, case in enumerate(cases) if _separation(*case, planned, fits[k]).separable]
    if not kept:
        raise ValueError(f"{first.name} and {second.name} predict the same ones")
    best, chosen = 0.0, tuple[int, ...]()
    for _ in range(_ROUNDS):
        columns = [_Columns.of(cases[k][0], fits[k], planned) for k in kept]
        information = np.array(
            [block_diag(*parts) for parts in zip(*(own.information for own in columns), strict=True)]
        )
        last = (np.cumsum([len(own.prior) for own in columns]) - 1).tolist()
        found = choose(information, block_diag(*(own.prior for own in columns)), count, last, minimax, seed, restarts=2)
        part = planned.only(np.array(found))
        fits = [_fitted(truth, rival, part) for truth, rival in cases]
        least = min(_separation(*cases[k], part, fits[k]).distance2 for k in kept)
        if least <= best:
            break
        best, chosen = least, found
    return chosen


@dataclass(frozen=True)
class _Columns:
    """Information (K, n + 1, n + 1) of each pose on a rival's unknowns and on the size of the difference, and of the
    priors (n + 1, n + 1)."""

    information: Array
    prior: Array

    @classmethod
    def of(cls, truth: RivalLaw, fitted: Unknowns, planned: Poses) -> _Columns:
        problem = fitted.problem([planned])
        z = np.zeros(len(problem.unknowns))
        (slopes,), prior_slopes = problem.whitened_slopes(z)
        (weights,), _ = problem.weights(z, 0.0)
        gap = Predictor(planned)(truth.unknowns.start) - problem.predicted(z)[0]
        rows = np.concatenate([slopes, -weights.whitened(gap)[:, :, None]], axis=2)
        prior_rows = np.concatenate([prior_slopes, problem.prior_rows(z)[1][:, None]], axis=1)
        weak = np.diag([_RIDGE] * len(z) + [0.0])
        return cls(np.einsum("kin,kim->knm", rows, rows), prior_rows.T @ prior_rows + weak)


def _problem(unknowns: Unknowns, data: Poses) -> LeastSquaresProblem:
    return LeastSquaresProblem([data], unknowns.start, (*unknowns.free, *unknowns.nuisance), unknowns.priors)


def _fitted(truth: RivalLaw, rival: RivalLaw, planned: Poses) -> Unknowns:
    """The rival's unknowns at its best fit to the tips of the true law."""
    problem = _problem(rival.unknowns, replace(planned, tip_m=Predictor(planned)(truth.unknowns.start)))
    found = problem.solve(np.zeros(len(problem.unknowns)))
    return replace(rival.unknowns, start=problem.setup(found.z, 0))


def _separation(truth: RivalLaw, rival: RivalLaw, planned: Poses, fitted: Unknowns) -> Separation:
    columns = _Columns.of(truth, fitted, planned)
    total = columns.prior + columns.information.sum(axis=0)
    explained = total[-1, :-1] @ np.linalg.solve(total[:-1, :-1], total[:-1, -1])
    more = len(rival.unknowns.free) - len(truth.unknowns.free)
    own = [one for one in fitted.free if one.name in rival.own]
    at_bound = sum(one.read(fitted.start) in (one.lower, one.upper) for one in own)
    distance2 = float(total[-1, -1] - explained)
    # The tips are still to be measured.
    independent = replace(planned, tip_m=np.zeros_like(planned.tip_m)).independent
    return Separation(truth.name, rival.name, distance2, 3 * len(planned), independent, more, at_bound)
