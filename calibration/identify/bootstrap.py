"""Error bars of the parametric bootstrap: refits to simulated data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calibration.identify.least_squares import LeastSquaresProblem
from calibration.identify.likelihood import Weights
from calibration.identify.orientation import turned_by
from calibration.identify.parameter import Prior
from calibration.identify.parameters import named
from calibration.identify.poses import Poses, section_kind
from calibration.identify.results import Fit
from calibration.identify.scaled_parameter import with_own_values
from calibration.identify.setup import Setup
from calibration.parallel_map import Progress, parallel_map
from model.arrays import Array


@dataclass(frozen=True)
class Bootstrap:
    """Refitted values (B, n) of the identified estimates `names` (n,), each with the run it belongs to."""

    names: tuple[str, ...]
    runs: tuple[str, ...]
    values: Array

    @property
    def std(self) -> Array:
        """Standard deviations (n,)."""
        out: Array = self.values.std(axis=0, ddof=1)
        return out

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Percentile interval of a parameter."""
        column = self.values[:, self.names.index(name)]
        low, high = np.quantile(column, [(1 - level) / 2, (1 + level) / 2])
        return float(low), float(high)


@dataclass(frozen=True)
class Refit:
    """One task: problem and solution of the fit, and the seed of the new data."""

    data: tuple[Poses, ...]
    start: Setup
    free: tuple[str, ...]
    per_run: tuple[str, ...]
    priors: tuple[tuple[str, Prior], ...]
    z: tuple[float, ...]
    fixed: tuple[int, ...]
    predicted: tuple[Array, ...]
    rotation: tuple[Array, ...]
    sections: tuple[tuple[tuple[Array, Array], ...], ...]
    weights: tuple[Weights, ...]
    seed: int


def bootstrap(
    fit: Fit,
    samples: int = 200,
    seed: int = 0,
    workers: int | None = None,
    scheduler: str | None = None,
    store: Path | None = None,
    progress: Progress | None = None,
) -> Bootstrap:
    """Refit `samples` times to data from the fitted model with the stated covariances (parametric bootstrap).

    The other arguments are those of `parallel_map`.
    """
    chosen = [i for i, e in enumerate(fit.estimates) if e.identified]
    fixed = tuple(i for i, is_fixed in enumerate(fit.fixed) if is_fixed)
    problem = fit.problem
    task = Refit(
        data=tuple(problem.data),
        start=problem.start,
        free=tuple(p.name for p in problem.free),
        per_run=tuple(p.name for p in problem.free if p.per_run),
        priors=tuple(problem.priors.items()),
        z=tuple(fit.solution.z.tolist()),
        fixed=fixed,
        predicted=tuple(run.predicted_m for run in fit.runs),
        rotation=tuple(problem.rotations(fit.solution.z)),
        sections=tuple(problem.sections(fit.solution.z)),
        weights=fit.solution.weights,
        seed=0,
    )
    tasks = [replace(task, seed=seed * 1_000_003 + k) for k in range(samples)]
    found = np.array(parallel_map(refit, tasks, workers, scheduler, store, progress))
    return Bootstrap(
        tuple(fit.estimates[i].name for i in chosen), tuple(fit.estimates[i].run for i in chosen), found[:, chosen]
    )


def refit(task: Refit) -> Array:
    """Values (n,) of every unknown, fitted to new data."""
    rng = np.random.default_rng(task.seed)
    actuators = task.data[0].actuators
    priors: Mapping[str, Prior] = dict(task.priors)
    data = [
        _drawn(rng, tips, rotation, sections, weights, poses)
        for poses, tips, rotation, sections, weights in zip(
            task.data, task.predicted, task.rotation, task.sections, task.weights, strict=True
        )
    ]
    free = with_own_values(named(task.free, actuators), task.per_run, actuators)
    problem = LeastSquaresProblem(data, task.start, free, priors)
    known = [i for i, u in enumerate(problem.unknowns) if u.parameter.name in priors]
    # The prior means are random, too: draw them around the values that are the truth here.
    z = np.array(task.z)
    start = problem.values(z)[known]
    mean, std = np.array([[priors[problem.unknowns[i].parameter.name].mean for i in known],
                          [priors[problem.unknowns[i].parameter.name].std for i in known]])  # fmt: skip
    problem.prior_shift = (start - mean) / std + rng.standard_normal(len(known))
    solution = problem.solve(z, task.fixed, rounds=1, evaluations=8)
    return problem.values(solution.z)


def _drawn(
    rng: np.random.Generator,
    tips: Array,
    rotation: Array,
    sections: Sequence[tuple[Array, Array]],
    weights: Weights,
    poses: Poses,
) -> Poses:
    """Poses that err as the weights say; NaN without a measurement.

    Tips (K, 3) with orientations (K, 3, 3), and the same of each section, are the true ones.
    """
    error = weights.drawn(rng)
    drawn = replace(poses, tip_m=np.where(poses.has_tip[:, None], tips + error[:, :3], np.nan))
    if poses.orientation is not None:
        turned = turned_by(poses.orientation, rotation, error[:, 3:6], poses.has_orientation)
        drawn = replace(drawn, orientation=turned)
    found = []
    for own, (point, turn) in zip(poses.sections, sections, strict=True):
        at = poses.columns(section_kind(own.name))
        section = replace(own, point_m=np.where(own.seen[:, None], point + error[:, at], np.nan))
        if own.orientation is not None:
            by = error[:, at.stop : at.stop + 3]
            section = replace(section, orientation=turned_by(own.orientation, turn, by, own.oriented))
        found.append(section)
    return replace(drawn, sections=tuple(found))
