"""Comparison of the paper's models on several runs, in the form of its Table 3."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from calibration.identify.comparison.candidates import Candidate, candidates
from calibration.identify.comparison.model_comparison import ModelComparison, compare_models, compared
from calibration.identify.observations.poses import Poses
from calibration.identify.unknowns.parameter import Prior
from calibration.identify.unknowns.setup import Setup
from protocols import arguments
from protocols.problems import bad_input, closest
from rig.config.schema import RigConfig
from rig.identify.estimation import Progress, check_priors, rig_uncertainties, sensor_priors

BASE = ("base",)
"""What is free in every law, beside its own parameters."""


def laws_named(names: Sequence[str], start: Setup, option: str, free: Sequence[str] = BASE) -> tuple[Candidate, ...]:
    """The two laws by name, from a setup. Laws of the push need no variant.

    option: where the names come from, for the message.

    Raises:
        BadInputError: an unknown name, or not two different laws.
    """
    names = arguments.names(option, names)
    every = {law.name: law for law in candidates(start, free)}
    short = {name.rpartition(", ")[2]: name for name in every}
    found = []
    for name in names:
        full = name if name in every else short.get(name)
        if full is None:
            expected = "one of " + "; ".join(every)
            raise bad_input(option, name, expected, closest(name, {**every, **short}))
        found.append(every[full])
    if len({law.name for law in found}) != 2:
        raise bad_input(option, " ".join(names), "two different laws")
    return tuple(found)


@dataclass(frozen=True)
class ComparedRun:
    """How much of a run is compared: the first frames of a motion, or evenly spaced plateaus."""

    run_id: str
    moving: bool
    frames: int
    of_frames: int


@dataclass(frozen=True)
class RunComparison:
    """The comparison, whether any run moves, and the runs of which only a part is compared."""

    comparison: ModelComparison
    moving: bool
    shortened: tuple[ComparedRun, ...]


def compare(
    start: Setup,
    data: Sequence[Poses],
    free: Sequence[str],
    priors: Mapping[str, Prior],
    scheduler: str | None = None,
    store: Path | None = None,
    progress: Progress = lambda done, total: None,
    between: tuple[str, str] | None = None,
    config: RigConfig | None = None,
) -> RunComparison:
    """Compare the models on the data of one or several runs by cross-validation.

    `free`: parameters that are free in every model beside its law; by default the pose of the base. scheduler, store:
    as for the bootstrap. between: only these two laws. Then every uncertain number of the rig `config` is a nuisance
    parameter, as in `from_poses`, and motions have a free damping.

    Raises:
        UnknownParameter: a name is unknown, or a prior belongs to a parameter that is free in no model.
        BadInputError: a prior is implausible, or a law is unknown.
        NoDataError: a single run is too short.
    """
    parts = [compared(whole) for whole in data]
    moving = any(part.moving for part in parts)
    stated = None
    if between is None or config is None:
        models = candidates(start, free or BASE, moving)
        known = dict(priors)
        estimated = [name for one in models for name in one.free]
    else:
        models = laws_named(between, start, "--between", free or BASE)
        models = tuple(one.with_damping() for one in models) if moving else models
        stated = rig_uncertainties(config, start)
        known = sensor_priors(stated) | dict(priors)
        estimated = list(stated)
    check_priors(priors, estimated, start.arm.actuators)
    found = compare_models(parts, models, known, None, scheduler, store, progress, stated)
    shortened = tuple(
        ComparedRun(whole.run_id, whole.moving, len(part), len(whole))
        for whole, part in zip(data, parts, strict=True)
        if len(part) < len(whole)
    )
    return RunComparison(found, moving, shortened)
