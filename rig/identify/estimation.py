"""Identification of an arm's parameters from runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from calibration.identify.data import Poses, poses_of, quasi_static_poses
from calibration.identify.figures import predictions
from calibration.identify.fit import identify
from calibration.identify.held_out_prediction import Prediction
from calibration.identify.parameters import Prior, Setup, UnknownParameter, named
from calibration.identify.results import Fit
from protocols import BadInputError, Problem
from rig.config.arm_model import model_arm
from rig.config.loader import RigFile
from rig.config.parameters_overlay import read as read_parameters
from rig.config.schema import RigConfig
from rig.config.sections import PA_PER_BAR
from rig.identify.initial_setup import rig_of
from rig.observation.online_estimation import default_parameters
from runs.report.drawing import save
from runs.run import Run

# A narrower prior, relative to the parameter's span, makes the problem ill-conditioned.
_SUREST = 1e-6
# Priors of the pressures' lag behind the camera clock, and of the sensors' time constant.
SENSOR_TIMES = {"sensor_lag_s": Prior(0.0, 0.005), "sensor_filter_s": Prior(0.003, 0.002)}

Progress = Callable[[int, int], None]
"""Called with the number of finished tasks and of all tasks."""


@dataclass(frozen=True)
class FitsByStart:
    """The fit from each initial rig, by its name; `best` has the maximum likelihood."""

    rigs: Mapping[str, RigFile]
    fits: Mapping[str, Fit]
    best: str


def rig_with(rig: RigFile, parameters: Path) -> str:
    """Return a rig's YAML with identified parameters and their model variant applied.

    Raises:
        BadInputError: the parameter file is invalid, or belongs to another arm.
    """
    found = read_parameters(parameters)
    return rig.identified(found, found.found.identified.variant).yaml


def poses(run: Run, quasi_static: bool = False) -> Poses:
    """Return the data of a run: plateaus or motion, or every frame as an equilibrium."""
    return quasi_static_poses(run) if quasi_static else poses_of(run)


def read_poses(
    archives: Sequence[Run], quasi_static: bool = False, progress: Progress = lambda done, total: None
) -> list[Poses]:
    """Return the data of several runs.

    Raises:
        NoDataError: a run has no usable data.
    """
    found: list[Poses] = []
    for run in archives:
        found.append(poses(run, quasi_static))
        progress(len(found), len(archives))
    return found


def from_runs(archives: Sequence[Run], free: Sequence[str], priors: Mapping[str, Prior]) -> Fit:
    """Identify an arm from whole runs as `from_poses` does, starting from the first run's rig.

    Raises:
        NoDataError: the first run has no rig, or a run has no usable data.
    """
    config = rig_of(archives[0])
    return from_poses(config, read_poses(archives), free, priors)


def most_likely_fit(
    rigs: Mapping[str, RigFile],
    data: Sequence[Poses],
    free: Sequence[str],
    priors: Mapping[str, Prior],
    starts: int = 1,
) -> FitsByStart:
    """Identify from each initial rig, as `from_poses` does; the best fit is the one of maximum likelihood."""
    fits = {name: from_poses(rig.config, data, free, priors, starts) for name, rig in rigs.items()}
    return FitsByStart(rigs, fits, max(fits, key=lambda name: fits[name].log_likelihood))


def from_poses(
    config: RigConfig, data: Sequence[Poses], free: Sequence[str], priors: Mapping[str, Prior], starts: int = 1
) -> Fit:
    """Identify an arm from runs, starting from a rig's arm.

    By default the parameters of `rig run --adapt` are free, and for dynamic runs the damping: otherwise base and law
    would absorb the lag of a motion. The sensors' stated accuracy is the prior of their offsets. Where damping or
    density is free, the sensors' delay is free too, with a prior of 5 ms, because it correlates with both.

    Raises:
        UnknownParameter: a name is unknown, or a prior belongs to a parameter that is not free.
    """
    moving = any(one.moving for one in data)
    chosen = tuple(free) or (*default_parameters(config.model.variant), *(("damping_s",) if moving else ()))
    if moving and {"damping_s", "density_kg_m3"} & set(chosen):
        chosen = (*chosen, *(name for name in SENSOR_TIMES if name not in chosen))
    check_priors(priors, chosen, config.actuators)
    accuracy = max(sensor.accuracy_bar for sensor in config.sensors) * PA_PER_BAR / 2
    all_priors = {"sensor_offsets": Prior(0.0, accuracy), **SENSOR_TIMES, **priors}
    return identify(data, Setup(model_arm(config)), chosen, all_priors, starts)


def check_priors(priors: Mapping[str, Prior], free: Sequence[str], actuators: int) -> None:
    """Refuse priors of parameters that are not free, and implausible priors.

    Raises:
        UnknownParameter: a prior of a parameter that is not free has no effect.
        BadInputError: a mean outside the parameter's bounds, or a deviation that is too small or too large.
    """
    chosen = {one.name for one in named(free, actuators)}
    for name, prior in priors.items():
        members = named([name], actuators)
        if chosen.isdisjoint(one.name for one in members):
            raise UnknownParameter(f"--prior {name}: it is not free; name it in --free, too")
        for one in members:
            least, most = _SUREST * one.span(prior.mean), one.upper - one.lower
            if not one.lower <= prior.mean <= one.upper:
                given, expected = f"{prior.mean:g}", f"a mean from {one.lower:g} to {one.upper:g} {one.unit}"
            elif not least <= prior.std <= most:
                given, expected = f"+-{prior.std:g}", f"a deviation from {least:.3g} to {most:.3g} {one.unit}"
            else:
                continue
            raise BadInputError([Problem("--prior", 0, 0, one.name, given, expected)])


def draw_predictions(found: Sequence[Prediction], file: Path) -> Path:
    """Draw the prediction error of each run over time, before and after identification."""
    file.parent.mkdir(parents=True, exist_ok=True)
    save(predictions, (9, 2.6 * len(found)), file, found)
    return file
