"""Information of planned experiments, with the noise model, priors and unknowns of the identification."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.identify.fitting.fit import OPEN_SPANS
from calibration.identify.fitting.noise import Noise, RunNoise
from calibration.identify.fitting.objective import Objective
from calibration.identify.observations.poses import Poses
from calibration.identify.prediction.forward_model import ForwardModel
from calibration.identify.simulated_experiments import located
from calibration.identify.unknowns.parameter import Parameter, Prior
from calibration.identify.unknowns.setup import Setup
from calibration.identify.unknowns.unknown import unknowns_of
from model.arrays import Array
from model.processors import usable_processors

# Time steps per frame. A gradient needs fewer than the tips of a fit: twice as many change no bar of `mock` by 2 %.
SUBSTEPS = 4


@dataclass(frozen=True)
class UnknownsOfDesign:
    """What an identification would estimate: free parameters and those beside, their priors by name, initial setup.

    arms: setups that the experiment may meet, as likely as each other; the initial one if there are none.
    """

    start: Setup
    free: tuple[Parameter, ...]
    beside: tuple[Parameter, ...]
    priors: Mapping[str, Prior]
    arms: tuple[Setup, ...] = ()

    def objective(self, planned: Sequence[Poses]) -> Objective:
        """The objective of planned experiments whose tips are exactly where the model predicts them."""
        unknowns = unknowns_of(self.start, len(planned), self.free, self.beside, self.priors)
        forward = ForwardModel(planned, self.start, unknowns, substeps=SUBSTEPS)
        theta = forward.first
        # The gradients bring the tips with them.
        forward.slopes(theta)
        predicted = zip(
            planned, forward.predicted(theta), forward.rotations(theta), forward.sections(theta), strict=True
        )
        exact = forward.measured_as([located(poses, (tips, turned), along) for poses, tips, turned, along in predicted])
        errors = zip(exact.data, exact.pressure_covariances(theta), strict=True)
        runs = (RunNoise(poses.pose_covariance + by, poses.measured) for poses, by in errors)
        return Objective(exact, Noise(tuple(runs), {}))


@dataclass(frozen=True)
class ErrorBars:
    """Expected standard errors `std` (n,), with names, units, values and spans, of the shared free parameters.

    by_arm (arms, n): std of each arm, of which `std` is the median: fine measurements make it depend on the arm.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    spans: Array
    std: Array
    by_arm: Array

    @property
    def decided(self) -> NDArray[np.bool_]:
        """Which parameters (n,) an identification would state, rather than report as not identifiable."""
        out: NDArray[np.bool_] = self.std <= OPEN_SPANS * self.spans
        return out


def of_interest(forward: ForwardModel) -> list[int]:
    """Indices of the unknowns whose error bars a design minimises: free, and shared by all runs."""
    return [i for i, one in enumerate(forward.unknowns) if one.run is None and one.free]


def block_information(objective: Objective, frames: Sequence[slice]) -> tuple[Array, Array]:
    """Information (B, n, n) of ranges of frames of the only run, and of the priors (n, n), in their deviations."""
    forward = objective.forward
    (run,), (slope,) = objective.noise.runs, forward.slopes(forward.first)
    rows = run.whitened(slope) * forward.std
    information = np.array([np.einsum("kin,kim->nm", rows[one], rows[one], optimize=True) for one in frames])
    return information, np.eye(len(forward.unknowns))


def error_bars(planned: Sequence[Poses], unknowns: UnknownsOfDesign) -> ErrorBars:
    """Expected standard errors of an identification from all the planned experiments together (Cramer-Rao bound).

    Medians over the arms of the unknowns.
    """
    return error_bars_of_repeats(planned, unknowns, (1.0,))[0]


def error_bars_of_repeats(
    planned: Sequence[Poses], unknowns: UnknownsOfDesign, repeats: Sequence[float]
) -> tuple[ErrorBars, ...]:
    """As `error_bars`, for each number of repeats of the planned experiments."""
    arms = unknowns.arms or (unknowns.start,)

    def of_arm(arm: Setup) -> list[Array]:
        objective = replace(unknowns, start=arm).objective(planned)
        theta = objective.forward.first
        return [np.sqrt(np.diagonal(_repeated(objective, count).covariance(theta))) for count in repeats]

    # The kernels of the rod model release the interpreter.
    with ThreadPoolExecutor(max_workers=min(len(arms), usable_processors())) as pool:
        found = list(pool.map(of_arm, arms))
    every = unknowns_of(unknowns.start, len(planned), unknowns.free, unknowns.beside, unknowns.priors)
    chosen = [i for i, one in enumerate(every) if one.free and one.run is None]
    names, units = tuple(every[i].name for i in chosen), tuple(every[i].parameter.unit for i in chosen)
    values, spans = (np.array([getattr(every[i], what) for i in chosen]) for what in ("start", "span"))
    by_repeats = [np.array(own)[:, chosen] for own in zip(*found, strict=True)]
    return tuple(ErrorBars(names, units, values, spans, np.median(own, axis=0), own) for own in by_repeats)


def _repeated(objective: Objective, count: float) -> Objective:
    """The objective of experiments that are the mean of so many repeats."""
    runs = (RunNoise(run.covariance / count, run.measured) for run in objective.noise.runs)
    return replace(objective, noise=Noise(tuple(runs), {}))
