"""Identified parameters laid over a rig, and what `rig identify` prints."""

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
from rig.cli.archive_output import plain_json
from rig.cli.run_output import console
from rig.config.arm_model import model_arm
from rig.config.parameters_overlay import overlay
from rig.config.parameters_overlay import read as read_parameters
from rig.config.schema import PA_PER_BAR, RigConfig
from rig.identify.initial_setup import InitialSetup, rig_of
from rig.observation.online_estimation import usual
from runs.report.drawing import save
from runs.run import Run

# A prior surer than this part of a parameter's span would drown in rounding what runs tell of the others.
_SUREST = 1e-6
# How late pressures may be behind the camera, as two clocks are, and how slow their sensors.
SENSOR_TIMES = {"sensor_lag_s": Prior(0.0, 0.005), "sensor_filter_s": Prior(0.003, 0.002)}


def rig_with(rig: InitialSetup, parameters: Path) -> str:
    """The YAML of a rig with identified parameters in it, whatever model the rig had.

    Raises:
        BadInput: the parameter file, or that they do not belong together.
    """
    found = read_parameters(parameters)
    return overlay(rig.yaml, rig.file, found, found.found.identified.variant, rig.laid)


def poses(run: Run, quasi_static: bool = False) -> Poses:
    """What identification takes from a run: plateaus or motion, or every frame as an equilibrium."""
    return quasi_static_poses(run) if quasi_static else poses_of(run)


def shown(archives: Sequence[Run], quasi_static: bool = False) -> list[Poses]:
    """What identification takes from some runs.

    Raises:
        NoData: nothing in a run can be used.
    """
    found: list[Poses] = []
    if not archives:
        return found
    with waiting("reading") as progress:
        for run in archives:
            found.append(poses(run, quasi_static))
            progress(len(found), len(archives))
    return found


def from_runs(archives: Sequence[Run], free: Sequence[str], priors: Mapping[str, Prior]) -> Fit:
    """Identify the arm of some whole runs, as `from_poses` does, from the arm of the first run's rig.

    Raises:
        NoData: no rig, or nothing in a run that can be used.
    """
    config = rig_of(archives[0])
    return from_poses(config, shown(archives), free, priors)


def likeliest(
    rigs: Mapping[str, InitialSetup],
    data: Sequence[Poses],
    free: Sequence[str],
    priors: Mapping[str, Prior],
    starts: int = 1,
) -> tuple[InitialSetup, Fit]:
    """Identify from each rig's arm and take what makes the runs likeliest; says so where there are several."""
    columns = (TextColumn("searching"), BarColumn(), TimeElapsedColumn())
    screen = console(stderr=True)
    with Progress(*columns, console=screen, transient=True, disable=not screen.is_terminal) as bar:
        bar.add_task("", total=None)
        fits = {name: from_poses(rig.config, data, free, priors, starts) for name, rig in rigs.items()}
    best = max(fits, key=lambda name: fits[name].log_likelihood)
    for name, fit in fits.items() if len(fits) > 1 else ():
        taken = ", taken" if name == best else ""
        said = f"from {name}: log likelihood {fit.log_likelihood:.1f}, rms {1e3 * fit.rms_m:.3f} mm{taken}"
        console(stderr=True).print(said, soft_wrap=True)
    return rigs[best], fits[best]


def from_poses(
    config: RigConfig, data: Sequence[Poses], free: Sequence[str], priors: Mapping[str, Prior], starts: int = 1
) -> Fit:
    """Identify an arm from what runs show of it, beginning at a rig's.

    Without `free` it is what `rig run --adapt` finds, and the damping where a run moves: without it base and law would
    answer for what a motion lags. The sensors' accuracy, as the rig states it, is the prior of their offsets. Where a
    motion is to tell damping or density, the sensors' delay, which passes for either, is free with a prior of 5 ms.

    Raises:
        UnknownParameter: a name stands for no parameter, or something is known beforehand of what is not free.
    """
    moving = any(one.moving for one in data)
    chosen = tuple(free) or (*usual(config.model.variant), *(("damping_s",) if moving else ()))
    if moving and {"damping_s", "density_kg_m3"} & set(chosen):
        chosen = (*chosen, *(name for name in SENSOR_TIMES if name not in chosen))
    check_priors(priors, chosen, config.actuators)
    accuracy = max(sensor.accuracy_bar for sensor in config.sensors) * PA_PER_BAR / 2
    believed = {"sensor_offsets": Prior(0.0, accuracy), **SENSOR_TIMES, **priors}
    return identify(data, Setup(model_arm(config)), chosen, believed, starts)


def check_priors(priors: Mapping[str, Prior], free: Sequence[str], actuators: int) -> None:
    """Refuse what is known beforehand of a parameter that is not free, and what nobody can know of one.

    Raises:
        UnknownParameter: of the first that is not free: it would change nothing.
        typer.BadParameter: of the first that lies where the parameter makes no sense, or is too sure or too vague.
    """
    chosen = {one.name for one in named(free, actuators)}
    for name, prior in priors.items():
        members = named([name], actuators)
        if chosen.isdisjoint(one.name for one in members):
            raise UnknownParameter(f"--prior {name}: it is not free; name it in --free, too")
        for one in members:
            least, most = _SUREST * one.span(prior.mean), one.upper - one.lower
            if not one.lower <= prior.mean <= one.upper:
                said = f"{prior.mean:g} {one.unit}; it lies between {one.lower:g} and {one.upper:g} {one.unit}"
            elif not least <= prior.std <= most:
                said = f"+-{prior.std:g} {one.unit}; a deviation lies between {least:.3g} and {most:.3g} {one.unit}"
            else:
                continue
            raise typer.BadParameter(f"{one.name} cannot be {said}", param_hint="--prior")


def show(fit: Fit, as_json: bool, under: Baseline | None = None) -> None:
    """Estimates with their error bars or verdicts, and how well each run is met."""
    if as_json:
        typer.echo(json.dumps(plain_json(content(fit, baseline=under)), indent=2))
        return
    screen = console()
    table = Table(box=None, padding=(0, 2, 0, 0))
    for head in ("parameter", "value", "+-", "95 %", "unit", "run"):
        table.add_column(head, justify="left" if head in ("parameter", "unit", "run") else "right", overflow="fold")
    untold = []
    for e, fixed in zip(fit.estimates, fit.fixed, strict=True):
        if e.value is None or e.std is None or e.interval is None:
            others = f" ({', '.join(e.partners)})" if e.partners else ""
            told = f"{e.name} {e.run}".strip()
            untold.append(f"{told}: {e.verdict.value}{others}; {'held at' if fixed else 'used'} {e.used:.5g} {e.unit}")
        else:
            low, high = e.interval
            table.add_row(e.name, f"{e.value:.6g}", f"{e.std:.2g}", f"{low:.5g} .. {high:.5g}", e.unit, e.run)
    screen.print(table)
    for words in untold:
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
        screen.print(Text("the search ended before it had converged", "yellow"))


def profiled(fit: Fit) -> tuple[Profile, ...]:
    """Profile likelihoods, with a progress bar on the error stream; prints their intervals."""
    screen = console(stderr=True)
    with waiting("profiles") as progress:
        found = profiles(fit, progress=progress)
    for one in found:
        ends = " .. ".join("open" if end is None else f"{end:.5g}" for end in one.interval)
        said = "flat: the data set it no end" if one.flat else ends
        screen.print(f"{one.name}: 95 % by profile {said}", soft_wrap=True)
    return found


def draw_predictions(found: Sequence[Prediction], file: Path) -> Path:
    """Draw how far each predicted run is missed, before and after, over time."""
    file.parent.mkdir(parents=True, exist_ok=True)
    save(predictions, (9, 2.6 * len(found)), file, found)
    return file


def told(found: Sequence[Prediction]) -> None:
    """How well runs that were left out are predicted."""
    for one in found:
        how = ", under its measured wrench" if one.under_wrench else ""
        said = f"rms {1e3 * one.rms_before_m:.3f} -> {1e3 * one.rms_m:.3f} mm, "
        said += f"mean {1e3 * one.mean_m:.3f} mm, 95 % below {1e3 * one.p95_m:.3f} mm"
        if one.unsolved:
            said += f"; {one.unsolved} of {len(one.error_m)} frames have no prediction and do not count"
        console(stderr=True).print(f"{one.run_id} (left out{how}): {said}", soft_wrap=True)


@contextmanager
def waiting(what: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar on the error stream, with the time left; call what it gives with (done, all)."""
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    # Fits of slow and quick models come in turns: the pace of the last seconds would tell little.
    period_s = 3600.0
    screen = console(stderr=True)
    quiet = not screen.is_terminal
    with Progress(*columns, console=screen, transient=True, disable=quiet, speed_estimate_period=period_s) as bar:
        job = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(job, completed=done, total=total)


def second_opinion(fit: Fit, samples: int, scheduler: str | None, store: Path | None) -> Bootstrap:
    """Bootstrap error bars beside those of the likelihood, with a progress bar on the error stream."""
    screen = console(stderr=True)
    with waiting("refitting") as progress:
        found = bootstrap(fit, samples, scheduler=scheduler, store=store, progress=progress)
    bars = {(e.name, e.run): e.std for e in fit.estimates}
    for name, run, std in zip(found.names, found.runs, found.std, strict=True):
        screen.print(f"{name} {run}: +- {std:.2g} by {samples} refits, {bars[name, run]:.2g} by the likelihood")
    return found
