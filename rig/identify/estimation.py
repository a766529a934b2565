"""Identification of an arm's parameters from runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from calibration.identify.fitting.fit import Progress as SearchProgress
from calibration.identify.fitting.fit import identify
from calibration.identify.fitting.results import Fit
from calibration.identify.observations.data import poses_of, quasi_static_poses
from calibration.identify.observations.poses import Poses
from calibration.identify.unknowns.memory_parameters import memory_names
from calibration.identify.unknowns.nuisance import nuisance_parameters, stated_values
from calibration.identify.unknowns.parameter import Prior
from calibration.identify.unknowns.parameters import UnknownParameter, named
from calibration.identify.unknowns.setup import Setup
from model.units import PA_PER_BAR
from protocols import BadInputError, Problem
from rig.config.arm_model import model_arm
from rig.config.loader import RigFile
from rig.config.parameters_overlay import read as read_parameters
from rig.config.schema import RigConfig
from rig.config.sections import Placement
from rig.observation.online_estimation import default_parameters, section_priors
from runs.run import Run

# A narrower prior, relative to the parameter's span, makes the problem ill-conditioned.
_SUREST = 1e-6
# Expected time constant of a pressure sensor.
SENSOR_FILTER_S = 0.003

Progress = Callable[[int, int], None]
"""Called with the number of finished tasks and of all tasks."""


def rig_with(rig: RigFile, parameters: Path) -> str:
    """Return a rig's YAML with identified parameters and their model variant applied.

    Raises:
        BadInputError: the parameter file is invalid, or belongs to another arm.
    """
    found = read_parameters(parameters)
    return rig.identified(found, found.found.identified.variant).yaml


def read_poses(
    archives: Sequence[Run], quasi_static: bool = False, progress: Progress = lambda done, total: None
) -> list[Poses]:
    """Return the data of several runs: plateaus or motion, or every frame as an equilibrium.

    Raises:
        NoDataError: a run has no usable data.
    """
    found: list[Poses] = []
    for run in archives:
        found.append(quasi_static_poses(run) if quasi_static else poses_of(run))
        progress(len(found), len(archives))
    return found


def from_poses(
    config: RigConfig,
    data: Sequence[Poses],
    free: Sequence[str],
    priors: Mapping[str, Prior],
    progress: SearchProgress = lambda text: None,
    per_run: Sequence[str] = (),
    noise: str = "adaptive",
) -> Fit:
    """Identify an arm from runs, starting from a rig's arm.

    By default the parameters of `rig run --adapt` are free, the branches and stop elements of the rig's arm, and for
    dynamic runs the damping: otherwise base and law would absorb the lag of a motion. Every other number that the tip
    depends on is a nuisance parameter: it is estimated, too, with the rig's value and its standard uncertainty as
    prior. A free parameter feels the uncertainty that the rig file states of it; without a statement its prior is a
    plausible span about the rig's value.
    Parameters of `per_run`, free or not, have a value of their own in each run.

    Raises:
        UnknownParameter: a name is unknown, or a prior or `per_run` names a parameter without effect on the data.
    """
    moving = any(one.moving for one in data)
    start = Setup(model_arm(config))
    chosen = tuple(free) or (
        *default_parameters(config), *memory_names(start.arm), *(("damping_s",) if moving else ())
    )  # fmt: skip
    beside = nuisance_parameters(start, data, named(chosen, config.actuators))
    check_priors(priors, (*chosen, *(p.name for p in beside)), config.actuators)
    stated = rig_uncertainties(config, start)
    return identify(
        data,
        start,
        chosen,
        sensor_priors(stated) | stated_priors(config, stated) | _by_parameter(priors, config.actuators),
        stated=stated,
        per_run=per_run,
        progress=progress,
        noise=noise,
    )


def rig_uncertainties(config: RigConfig, start: Setup) -> dict[str, Prior]:
    """Value and standard uncertainty of each parameter of a rig, by name; the start is the rig's setup.

    Half the accuracy of a sensor is the standard uncertainty of its offset.
    """
    offsets = {f"sensor_{s.actuator}_offset_pa": s.accuracy_bar * PA_PER_BAR / 2 for s in config.sensors}
    board = Placement() if config.board is None else config.board.placement
    mounted = {"tool": board.translation_std_mm * 1e-3, "tool_rotation": math.radians(board.rotation_std_deg)}
    tool = {name: std for name, std in mounted.items() if std}
    found = stated_values(start, {**offsets, **tool, **config.uncertainties.stated()})
    found["sensor_filter_s"] = Prior(SENSOR_FILTER_S, found["sensor_filter_s"].std)
    return found | section_priors(config)


def sensor_priors(stated: Mapping[str, Prior]) -> dict[str, Prior]:
    """Return the priors of free parameters: only sensors have one, because their data sheets hold in any case."""
    return {name: prior for name, prior in stated.items() if name.startswith("sensor_") and "gain" not in name}


def stated_priors(config: RigConfig, stated: Mapping[str, Prior]) -> dict[str, Prior]:
    """Return the priors of the parameters whose uncertainty the rig file states: free or not, they feel it."""
    explicit = named(config.uncertainties.stated(), config.actuators)
    return {one.name: stated[one.name] for one in explicit if one.name in stated}


def _by_parameter(priors: Mapping[str, Prior], actuators: int) -> dict[str, Prior]:
    return {p.name: prior for name, prior in priors.items() for p in named([name], actuators)}


def check_priors(priors: Mapping[str, Prior], estimated: Sequence[str], actuators: int) -> None:
    """Refuse priors of parameters that are not estimated, and implausible priors.

    Raises:
        UnknownParameter: a prior of a parameter that is not estimated has no effect.
        BadInputError: a mean outside the parameter's bounds, or a deviation that is too small or too large.
    """
    chosen = {one.name for one in named(estimated, actuators)}
    for name, prior in priors.items():
        members = named([name], actuators)
        if chosen.isdisjoint(one.name for one in members):
            raise UnknownParameter(f"--prior {name}: it has no effect on these runs")
        for one in members:
            least, most = _SUREST * one.span(prior.mean), one.upper - one.lower
            if not one.lower <= prior.mean <= one.upper:
                given, expected = f"{prior.mean:g}", f"a mean from {one.lower:g} to {one.upper:g} {one.unit}"
            elif not least <= prior.std <= most:
                given, expected = f"+-{prior.std:g}", f"a deviation from {least:.3g} to {most:.3g} {one.unit}"
            else:
                continue
            raise BadInputError([Problem("--prior", 0, 0, one.name, given, expected)])
