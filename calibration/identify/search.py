"""Search for the maximum of the likelihood from several starting points."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.identify.least_squares import LeastSquaresProblem
from calibration.identify.nuisance import MOTION_ONLY
from calibration.identify.poses import Poses
from calibration.identify.solution import Solution
from model.arrays import Array

Progress = Callable[[str], None]
"""Called with a short text about the state of the search."""

# Two searches agree if -2 ln L differs by less.
SAME_OPTIMUM = 1.0
# A first result is clearly better than its start if the rms falls below this fraction, or if no error is unexplained.
_CLEARLY_BETTER = 0.5
_MAX_STARTS = 4
# Frames of a long motion that give the starting point.
_SHORT = 900
# An undamped arm rings in a way that no real one does, and the search would follow the ringing.
_TYPICAL_DAMPING_S = 0.01
# Smallest loss of -2 ln L against the start, and smallest growth of the rms, that make a result worse than its start.
_WORSE_LIKELIHOOD, _WORSE_RMS = 4.0, 1.02


@dataclass(frozen=True)
class SearchResult:
    """The best solution, and -2 ln L of each search relative to it, in the order of the starting points.

    worse_than_start: the starting parameters explain the data better than the best solution.
    """

    best: Solution
    losses: tuple[float, ...]
    worse_than_start: bool

    @property
    def agreeing(self) -> int:
        """Number of searches that ended at the best solution."""
        return sum(loss < SAME_OPTIMUM for loss in self.losses)


def search(
    problem: LeastSquaresProblem, first: Array, starts: int | None, seed: int, progress: Progress
) -> SearchResult:
    """Search from `first` (n,) and from random points around it; the most likely result is the best.

    starts: number of starting points; None starts again, up to four times in total, while the best result is not
    clearly better than the starting parameters or no two results agree.
    """
    rng = np.random.default_rng(seed)
    at_start = np.zeros(len(problem.unknowns))
    rms_m, likelihood = problem.rms_m(at_start), problem.log_likelihood(at_start)
    found: list[Solution] = []

    def best() -> Solution:
        return max(found, key=lambda s: s.log_likelihood)

    def losses() -> tuple[float, ...]:
        return tuple(2 * (best().log_likelihood - s.log_likelihood) for s in found)

    def enough() -> bool:
        if starts is not None:
            return len(found) == starts
        if len(found) == 1:
            return _convincing(problem, found[0], rms_m)
        return len(found) == _MAX_STARTS or sum(loss < SAME_OPTIMUM for loss in losses()) > 1

    while not found or not enough():
        number = len(found) + 1
        step = 0

        def show(now_m: float, number: int = number) -> None:
            nonlocal step
            step += 1
            progress(f"start {number}, step {step}: rms {1e3 * now_m:.3f} mm")

        problem.progress = show
        found.append(problem.solve(first if number == 1 else random_start(problem, first, rng)))
    problem.progress = lambda _: None
    return SearchResult(best(), losses(), _worse(problem, best(), rms_m, likelihood))


def _convincing(problem: LeastSquaresProblem, solution: Solution, start_rms_m: float) -> bool:
    if not solution.solved:
        return False
    return solution.discrepancy_m == 0 or problem.rms_m(solution.z) < _CLEARLY_BETTER * start_rms_m


def _worse(problem: LeastSquaresProblem, solution: Solution, start_rms_m: float, start_likelihood: float) -> bool:
    # Each likelihood takes a model discrepancy of its own, so that far from the data they do not compare.
    if problem.rms_m(solution.z) < _CLEARLY_BETTER * start_rms_m:
        return False
    if 2 * (start_likelihood - problem.log_likelihood(solution.z)) > _WORSE_LIKELIHOOD:
        return True
    return solution.discrepancy_m > 0 and not problem.rms_m(solution.z) <= _WORSE_RMS * start_rms_m


def initial_point(problem: LeastSquaresProblem, progress: Progress) -> Array:
    """First starting point (n,): the solution of cheaper data.

    These are the static runs, if there are both kinds, then the first frames of long motions.
    """
    z = np.zeros(len(problem.unknowns))
    data = problem.data
    for i, unknown in enumerate(problem.unknowns):
        if unknown.parameter.name == "damping_s" and unknown.start == 0 and any(poses.moving for poses in data):
            z[i] = unknown.of(_TYPICAL_DAMPING_S)
    resting = [run for run, poses in enumerate(data) if not poses.moving]
    if 0 < len(resting) < len(data):
        z = _from_part(problem, z, resting, [data[run] for run in resting], progress)
    if any(poses.moving and len(poses) > 2 * _SHORT for poses in data):
        short = [poses.only(np.arange(min(len(poses), _SHORT))) if poses.moving else poses for poses in data]
        if all(poses.has_tip.any() for poses in short):
            z = _from_part(problem, z, range(len(data)), short, progress)
    return z


def _from_part(
    problem: LeastSquaresProblem, z: Array, runs: Sequence[int], data: Sequence[Poses], progress: Progress
) -> Array:
    """The point z (n,) with the unknowns that `data`, parts of some runs, depend on at their solution."""
    part = LeastSquaresProblem(
        data,
        problem.start,
        problem.free,
        problem.priors,
        substeps=problem.substeps,
        extrapolated=problem.extrapolated,
        progress=lambda rms_m: progress(f"part of the data: rms {1e3 * rms_m:.3f} mm"),
    )
    place = {(u.parameter.name, u.run): i for i, u in enumerate(problem.unknowns)}
    mine = [place[u.parameter.name, None if u.run is None else runs[u.run]] for u in part.unknowns]
    still = not any(poses.moving for poses in data)
    fixed = [k for k, u in enumerate(part.unknowns) if still and u.parameter.name in MOTION_ONLY]
    out = z.copy()
    out[mine] = part.solve(z[mine], fixed).z
    return out


def point_of(problem: LeastSquaresProblem, values: Mapping[tuple[str, str], float]) -> Array:
    """Values by (name, run), in spans (n,); zero for those not given."""
    z = np.zeros(len(problem.unknowns))
    for i, unknown in enumerate(problem.unknowns):
        run = "" if unknown.run is None else problem.data[unknown.run].run_id
        value = values.get((unknown.parameter.name, run), unknown.start)
        z[i] = np.clip(unknown.of(value), unknown.lower, unknown.upper)
    return z


def random_start(problem: LeastSquaresProblem, first: Array, rng: np.random.Generator) -> Array:
    """A random starting point: within half a span of the first, or within `Parameter.decades` powers of ten.

    A parameter with a prior starts within two standard deviations of the prior.
    """
    z = first + rng.uniform(-0.5, 0.5, len(first))
    for i, unknown in enumerate(problem.unknowns):
        decades, prior = unknown.parameter.decades, problem.priors.get(unknown.parameter.name)
        if prior is not None:
            z[i] = unknown.of(prior.mean + prior.std * rng.uniform(-2.0, 2.0))
        elif decades:
            z[i] = unknown.of(unknown.at(float(first[i])) * 10 ** rng.uniform(-decades, decades))
        z[i] = np.clip(z[i], unknown.lower, unknown.upper)
    return z
