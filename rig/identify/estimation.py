"""Identification of an arm's parameters from runs, and the output of `rig identify`."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import typer
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from calibration.identify.bootstrap import Bootstrap, bootstrap
from calibration.identify.data import Poses, poses_of, quasi_static_poses
from calibration.identify.figures import predictions
from calibration.identify.fit import identify
from calibration.identify.held_out_prediction import Prediction
from calibration.identify.parameters import Prior, Setup, UnknownParameter, named
from calibration.identify.parameters_document import Baseline, content
from calibration.identify.profile_likelihood import Profile, profiles
from calibration.identify.results import Fit
from rig.cli.console import console
from rig.cli.json_output import plain_json
from rig.config.arm_model import model_arm
from rig.config.parameters_overlay import overlay
from rig.config.parameters_overlay import read as read_parameters
from rig.config.schema import RigConfig
from rig.config.sections import PA_PER_BAR
from rig.identify.initial_setup import InitialSetup, rig_of
from rig.observation.online_estimation import default_parameters
from runs.report.drawing import save
from runs.run import Run

# A narrower prior, relative to the parameter's span, makes the problem ill-conditioned.
_SUREST = 1e-6
# Priors of the pressures' lag behind the camera clock, and of the sensors' time constant.
SENSOR_TIMES = {"sensor_lag_s": Prior(0.0, 0.005), "sensor_filter_s": Prior(0.003, 0.002)}


def rig_with(rig: InitialSetup, parameters: Path) -> str:
    """Return a rig's YAML with identified parameters and their model variant applied.

    Raises:
        BadInputError: the parameter file is invalid, or belongs to another arm.
    """
    found = read_parameters(parameters)
    return overlay(rig.yaml, rig.file, found, found.found.identified.variant, rig.parameters_yaml)


def poses(run: Run, quasi_static: bool = False) -> Poses:
    """Return the data of a run: plateaus or motion, or every frame as an equilibrium."""
    return quasi_static_poses(run) if quasi_static else poses_of(run)


def read_poses(archives: Sequence[Run], quasi_static: bool = False) -> list[Poses]:
    """Return the data of several runs, with a progress bar.

    Raises:
        NoDataError: a run has no usable data.
    """
    found: list[Poses] = []
    if not archives:
        return found
    with progress_bar("reading") as progress:
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
    rigs: Mapping[str, InitialSetup],
    data: Sequence[Poses],
    free: Sequence[str],
    priors: Mapping[str, Prior],
    starts: int = 1,
) -> tuple[InitialSetup, Fit]:
    """Identify from each initial rig; return the fit of maximum likelihood. Print the fits if there are several."""
    columns = (TextColumn("searching"), BarColumn(), TimeElapsedColumn())
    screen = console(stderr=True)
    with Progress(*columns, console=screen, transient=True, disable=not screen.is_terminal) as bar:
        bar.add_task("", total=None)
        fits = {name: from_poses(rig.config, data, free, priors, starts) for name, rig in rigs.items()}
    best = max(fits, key=lambda name: fits[name].log_likelihood)
    for name, fit in fits.items() if len(fits) > 1 else ():
        chosen = ", chosen" if name == best else ""
        line = f"from {name}: log likelihood {fit.log_likelihood:.1f}, rms {1e3 * fit.rms_m:.3f} mm{chosen}"
        console(stderr=True).print(line, soft_wrap=True)
    return rigs[best], fits[best]


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
        typer.BadParameter: a mean outside the parameter's bounds, or a deviation that is too small or too large.
    """
    chosen = {one.name for one in named(free, actuators)}
    for name, prior in priors.items():
        members = named([name], actuators)
        if chosen.isdisjoint(one.name for one in members):
            raise UnknownParameter(f"--prior {name}: it is not free; name it in --free, too")
        for one in members:
            least, most = _SUREST * one.span(prior.mean), one.upper - one.lower
            if not one.lower <= prior.mean <= one.upper:
                prior_text = f"{prior.mean:g} {one.unit}; it lies between {one.lower:g} and {one.upper:g} {one.unit}"
            elif not least <= prior.std <= most:
                prior_text = (
                    f"+-{prior.std:g} {one.unit}; a deviation lies between {least:.3g} and {most:.3g} {one.unit}"
                )
            else:
                continue
            raise typer.BadParameter(f"{one.name} cannot be {prior_text}", param_hint="--prior")


def print_estimates(fit: Fit, as_json: bool, under: Baseline | None = None) -> None:
    """Print the estimates with error bars or verdicts, and the residuals of each run."""
    if as_json:
        typer.echo(json.dumps(plain_json(content(fit, baseline=under)), indent=2))
        return
    screen = console()
    table = Table(box=None, padding=(0, 2, 0, 0))
    for head in ("parameter", "value", "+-", "95 %", "unit", "run"):
        table.add_column(head, justify="left" if head in ("parameter", "unit", "run") else "right", overflow="fold")
    undetermined = []
    for e, held in zip(fit.estimates, fit.fixed, strict=True):
        if e.value is None or e.std is None or e.interval is None:
            others = f" ({', '.join(e.partners)})" if e.partners else ""
            label = f"{e.name} {e.run}".strip()
            undetermined.append(
                f"{label}: {e.verdict.value}{others}; {'held at' if held else 'used'} {e.used:.5g} {e.unit}"
            )
        else:
            low, high = e.interval
            table.add_row(e.name, f"{e.value:.6g}", f"{e.std:.2g}", f"{low:.5g} .. {high:.5g}", e.unit, e.run)
    screen.print(table)
    for words in undetermined:
        screen.print(Text(words, "yellow"), soft_wrap=True)
    for run in fit.runs:
        kind = "motion" if run.moving else "plateaus"
        before, after = 1e3 * run.rms_before_m, 1e3 * run.rms_m
        screen.print(
            f"{run.run_id} ({kind}): rms {before:.3f} -> {after:.3f} mm, {run.outliers} outliers", soft_wrap=True
        )
    if fit.discrepancy_m:
        screen.print(f"the model is off by {1e3 * fit.discrepancy_m:.3f} mm per axis beyond the stated errors")
    if fit.drifts:
        screen.print(Text(fit.drifts, "yellow"), soft_wrap=True)
    for words in fit.open_directions:
        screen.print(Text(f"left open by the data: {words}", "yellow"), soft_wrap=True)
    if not fit.solved:
        screen.print(Text("the Gauss-Newton search did not converge", "yellow"))


def profile_likelihoods(fit: Fit) -> tuple[Profile, ...]:
    """Compute profile likelihoods with a progress bar on standard error; print their intervals."""
    screen = console(stderr=True)
    with progress_bar("profiles") as progress:
        found = profiles(fit, progress=progress)
    for one in found:
        ends = " .. ".join("open" if end is None else f"{end:.5g}" for end in one.interval)
        interval = "flat: not bounded by the data" if one.flat else ends
        screen.print(f"{one.name}: 95 % by profile {interval}", soft_wrap=True)
    return found


def draw_predictions(found: Sequence[Prediction], file: Path) -> Path:
    """Draw the prediction error of each run over time, before and after identification."""
    file.parent.mkdir(parents=True, exist_ok=True)
    save(predictions, (9, 2.6 * len(found)), file, found)
    return file


def print_prediction_errors(found: Sequence[Prediction]) -> None:
    """Print the prediction errors of held-out runs."""
    for one in found:
        how = ", under its measured wrench" if one.under_wrench else ""
        errors = f"rms {1e3 * one.rms_before_m:.3f} -> {1e3 * one.rms_m:.3f} mm, "
        errors += f"mean {1e3 * one.mean_m:.3f} mm, 95 % below {1e3 * one.p95_m:.3f} mm"
        if one.unsolved:
            errors += f"; {one.unsolved} of {len(one.error_m)} frames have no prediction and are excluded"
        console(stderr=True).print(f"{one.run_id} (left out{how}): {errors}", soft_wrap=True)


@contextmanager
def progress_bar(what: str) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar on standard error; yield a function to call with (done, total)."""
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    # Slow and fast models alternate, so the remaining time needs an average over a long period.
    period_s = 3600.0
    screen = console(stderr=True)
    quiet = not screen.is_terminal
    with Progress(*columns, console=screen, transient=True, disable=quiet, speed_estimate_period=period_s) as bar:
        job = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(job, completed=done, total=total)


def bootstrap_errors(fit: Fit, samples: int, scheduler: str | None, store: Path | None) -> Bootstrap:
    """Compute bootstrap errors with a progress bar on standard error; print them beside the likelihood's."""
    screen = console(stderr=True)
    with progress_bar("refitting") as progress:
        found = bootstrap(fit, samples, scheduler=scheduler, store=store, progress=progress)
    bars = {(e.name, e.run): e.std for e in fit.estimates}
    for name, run, std in zip(found.names, found.runs, found.std, strict=True):
        screen.print(f"{name} {run}: +- {std:.2g} by {samples} refits, {bars[name, run]:.2g} by the likelihood")
    return found
