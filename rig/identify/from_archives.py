"""The whole identification from archives: read, check, split, search, predict what is held out."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from calibration.baselines.comparison import Comparison, on_blocks, on_left_out
from calibration.baselines.methods import ConstantCurvature
from calibration.baselines.repeatability import Repeatability, repeatability
from calibration.baselines.selection import BaselineFit, fit_baselines
from calibration.identify import split_at
from calibration.identify.fitting.blocks_left_out import blocks_left_out
from calibration.identify.fitting.fit import Progress as SearchProgress
from calibration.identify.fitting.held_out_prediction import Prediction, predict
from calibration.identify.fitting.noise import NOISE_MODELS
from calibration.identify.fitting.results import Fit
from calibration.identify.observations.poses import Poses
from calibration.identify.observations.pressure_lag import behind
from calibration.identify.presentation.parameters_document import Baseline
from calibration.identify.unknowns.parameter import Prior
from protocols import Problem, arguments
from protocols.problems import bad_input, closest, raise_all
from rig.config.arm_model import model_arm
from rig.config.loader import RigFile
from rig.identify import estimation, initial_setup
from rig.identify.conclusion import conclusion
from runs.run import Run

Reader = Callable[[Sequence[Run], bool], list[Poses]]


@dataclass(frozen=True)
class OpenedRuns:
    """Runs to identify from, runs that are held out, and notes on both."""

    seen: tuple[Run, ...]
    held_out: tuple[Run, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Identification:
    """The fit, the rig that it began with, and the data that were held out.

    `baseline` is the geometry that the estimates are relative to. `baselines` are fitted to the same data. Frames of
    slow motions are taken under pressures behind a lag `pressure_lag_s`, which constant curvature chose on blocks of
    the fit's data that were left out.
    """

    rig: RigFile
    fit: Fit
    baseline: Baseline | None
    held_out: tuple[Poses, ...]
    notes: tuple[str, ...]
    baselines: tuple[BaselineFit, ...]
    pressure_lag_s: float

    @cached_property
    def predictions(self) -> tuple[Prediction, ...]:
        """Predictions of the data that were held out."""
        return tuple(predict(self.fit, behind(poses, self.pressure_lag_s)) for poses in self.held_out)

    @cached_property
    def comparisons(self) -> tuple[Comparison, ...]:
        """The rod beside the baselines: on blocks of the fit's data, and on each run that was held out."""
        length_m = self.fit.start.arm.length_m
        blocks = on_blocks(self.baselines, np.concatenate(blocks_left_out(self.fit)), length_m)
        unseen = [
            on_left_out(self.baselines, poses, one.measured_m - one.predicted_m, one.covariance_m2, length_m)
            for poses, one in zip(self.held_out, self.predictions, strict=True)
        ]
        return (blocks, *unseen)

    @property
    def conclusion(self) -> tuple[str, ...]:
        """The conclusion in five lines."""
        return conclusion(self.fit, self.comparisons, self.repeatability, self.held_out)

    @cached_property
    def repeatability(self) -> Repeatability | None:
        """How well the tip repeats in all of the data; None where no state returns."""
        return repeatability((*self.fit.forward.data, *self.held_out))


def open_runs(archives: Sequence[Path], leave_out: Sequence[Path] = (), *, one_arm: bool = False) -> OpenedRuns:
    """Open the runs to identify from, and those left out; `one_arm` as in `initial_setup.check_alike`.

    Raises:
        ArchiveError: an archive does not exist.
        NoDataError: the runs are of different arms, or of one run twice.
        BadInputError: every run is left out.
    """
    unseen, doubled_out = initial_setup.open_archives(leave_out)
    every, doubled = initial_setup.open_archives(archives)
    left_out = {run.sha256 for run in unseen}
    seen = [run for run in every if run.sha256 not in left_out]
    if not seen:
        reason = "every run is left out: nothing is left to identify from" if every else "needs at least one run"
        raise bad_input("--leave-out" if every else "RUN", "", reason)
    alike = initial_setup.check_alike([*seen, *unseen], one_arm)
    return OpenedRuns(tuple(seen), tuple(unseen), (*doubled_out, *doubled, *alike))


@dataclass(frozen=True)
class IdentificationData:
    """The initial rig, the data to identify from, and the data to predict."""

    opened: OpenedRuns
    rig: RigFile
    seen: list[Poses]
    held_out: list[Poses]
    from_recorded_rig: bool


def read_data(
    opened: OpenedRuns,
    *,
    start: str | None = None,
    quasi_static: bool = False,
    every: int = 1,
    split_s: float | None = None,
    read: Reader = estimation.read_poses,
) -> IdentificationData:
    """Read the runs; the initial rig is `start`, by name or file, else the first run's own.

    Raises:
        NoDataError: a run has no usable data.
        BadInputError: an option is invalid, or a rig or a run has another number of actuators.
    """
    _check_numbers(quasi_static, every, split_s)
    rig = initial_setup.initial_rig(opened.seen[0], start)
    data = read(opened.seen, quasi_static)
    held_out = read(opened.held_out, quasi_static) if opened.held_out else []
    _check_actuators(data[0].actuators, rig, held_out)
    data, held_out = _split(data, held_out, split_s, every)
    if start is not None:
        data = [dataclasses.replace(poses, live_m=None) for poses in data]
    return IdentificationData(opened, rig, data, held_out, from_recorded_rig=start is None)


def from_data(
    data: IdentificationData,
    *,
    free: Sequence[str],
    priors: Mapping[str, Prior],
    per_run: Sequence[str] = (),
    noise: str = "adaptive",
    progress: SearchProgress = lambda text: None,
) -> Identification:
    """Identify as `estimation.from_poses` does.

    Raises:
        UnknownParameter: a name is unknown, or a prior or `per_run` names a parameter without effect on the data.
        BadInputError: a prior or the name of the noise model is invalid.
    """
    _check_noise(noise)
    progress("baselines, then the rod")
    arm = model_arm(data.rig.config)
    baselines = fit_baselines(data.seen, arm.gravity_m_s2)
    lag_s = 0.0 if arm.remembers else next(one.lag_s for one in baselines if one.name == ConstantCurvature.name)
    seen = [behind(one, lag_s) for one in data.seen]
    fit = estimation.from_poses(data.rig.config, seen, free, priors, progress, per_run, noise)
    baseline = initial_setup.baseline_geometry(data.opened.seen[0], fit.start, data.from_recorded_rig)
    if all(one.moving or one.course is None for one in seen):
        lag_s = 0.0
    return Identification(data.rig, fit, baseline, tuple(data.held_out), data.opened.notes, baselines, lag_s)


def check_arguments(
    *,
    free: object,
    priors: object,
    quasi_static: object,
    per_run: object = (),
    every: object = 1,
    split_s: object = None,
    texts: Mapping[str, object] | None = None,
) -> None:
    """Refuse arguments of a wrong type before a run is read; `texts` by option, None where one is not given."""
    raise_all(arguments.flag_problems({"--quasi-static": quasi_static}))
    raise_all(arguments.text_problems({o: text for o, text in (texts or {}).items() if text is not None}))
    _check_numbers(bool(quasi_static), every, split_s)
    arguments.names("--free", free)
    arguments.names("--per-run", per_run)
    given = {} if priors is None else priors
    if not isinstance(given, Mapping) or not all(
        isinstance(name, str) and isinstance(prior, Prior) for name, prior in given.items()
    ):
        expected = "a mapping from names to calibration.identify.Prior(mean, std)"
        raise bad_input("--prior", arguments.shown(priors), expected)


def _check_noise(name: str) -> None:
    if name not in NOISE_MODELS:
        raise bad_input(
            "--noise", arguments.shown(name), f"one of {', '.join(NOISE_MODELS)}", closest(name, NOISE_MODELS)
        )


def _check_numbers(quasi_static: bool, every: object, split_s: object) -> None:
    problems = arguments.whole_number_problems("--every", every, 1)
    if not problems and every != 1 and not quasi_static:
        problems.append(Problem("--every", 0, 0, "", str(every), "needs --quasi-static"))
    seconds = arguments.finite(split_s)
    if split_s is not None and (seconds is None or seconds < 0):
        problems.append(Problem("--split-s", 0, 0, "", arguments.shown(split_s), "a time of at least 0 s"))
    raise_all(problems)


def _check_actuators(actuators: int, rig: RigFile, held_out: Sequence[Poses]) -> None:
    """Refuse an initial rig and held-out runs with another number of actuators than the runs."""
    if rig.config.actuators != actuators:
        reason = f"{rig.file} has {rig.config.actuators} actuators, the runs have {actuators}"
        raise bad_input("--start", "", reason)
    for poses in held_out:
        if poses.actuators != actuators:
            reason = f"{poses.run_id} is of {poses.actuators} actuators, the others are of {actuators}"
            raise bad_input("--leave-out", "", reason)


def _split(
    data: list[Poses], held_out: list[Poses], split_s: float | None, every: int
) -> tuple[list[Poses], list[Poses]]:
    """Return the data to identify from, every Nth frame of it, and the data to predict."""
    if split_s is not None:
        parts = [split_at(poses, split_s) for poses in data]
        data, held_out = [before for before, _ in parts], [after for _, after in parts] + held_out
    return [poses.only(np.arange(0, len(poses), every)) for poses in data], held_out
