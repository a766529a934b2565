"""Comparison of the paper's models on several runs, in the form of its Table 3."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from calibration.identify.candidates import candidates
from calibration.identify.model_comparison import ModelComparison, compare_models, compared
from calibration.identify.parameter import Prior
from calibration.identify.poses import Poses
from calibration.identify.setup import Setup
from rig.config.schema import RigConfig
from rig.identify.estimation import Progress, check_priors, rig_uncertainties, sensor_priors
from rig.identify.law_names import BASE, laws_named


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
    check_priors(priors, estimated, start.arm.geometry.actuators)
    found = compare_models(parts, models, known, None, scheduler, store, progress, stated)
    shortened = tuple(
        ComparedRun(whole.run_id, whole.moving, len(part), len(whole))
        for whole, part in zip(data, parts, strict=True)
        if len(part) < len(whole)
    )
    return RunComparison(found, moving, shortened)
