"""Identified parameters laid over a rig, and what `rig identify` prints."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text
from scipy.spatial.transform import Rotation

from calibration.identify.bootstrap import Bootstrap, bootstrap
from calibration.identify.data import NoData, Poses, as_if_at_rest, poses_of
from calibration.identify.document import content
from calibration.identify.figures import predictions
from calibration.identify.fit import Fit, identify
from calibration.identify.parameters import Prior, Setup, known
from calibration.identify.prediction import Prediction
from calibration.identify.profile import Profile, profiles
from rig.arm import model_arm, true_arm
from rig.config import PA_PER_BAR, RigConfig
from rig.listing import plain_json
from rig.optics import rigid
from rig.parameters import laid_over
from rig.parameters import read as read_parameters
from rig.rig_file import load, parse, path_of, text
from rig.screens import console
from runs.figures import save
from runs.run import Run

# How late pressures may be behind the camera, as two clocks are, and how slow their sensors.
SENSOR_TIMES = {"sensor_lag_s": Prior(0.0, 0.005), "sensor_filter_s": Prior(0.003, 0.002)}
DEFAULT = ("law", "rpe_per_bar", "base", "sensor_offsets")
DEFAULT_HOMOGENEOUS = ("youngs_modulus_pa", "rpe_per_bar", "base", "sensor_offsets")


def rig_with(rig: str, parameters: Path) -> str:
    """The YAML of a rig with identified parameters in it, whatever model the rig had.

    Raises:
        BadInput: the rig, the parameter file, or that they do not belong together.
    """
    found = read_parameters(parameters)
    return laid_over(text(rig), path_of(rig), found, found.found.identified.variant)


def poses(run: Run, quasi_static: bool = False) -> Poses:
    """What identification takes from a run: plateaus or motion, or every frame as an equilibrium."""
    return as_if_at_rest(run) if quasi_static else poses_of(run)


def shown(archives: Sequence[Run], quasi_static: bool = False) -> list[Poses]:
    """What identification takes from some runs.

    Raises:
        NoData: nothing in a run can be used.
    """
    found = []
    with waiting("reading") as progress:
        for run in archives:
            found.append(poses(run, quasi_static))
            progress(len(found), len(archives))
    return found


def setup_of(run: Run) -> Setup:
    """The arm as the run's rig states it.

    Raises:
        NoData: the archive, of an import, names no rig.
    """
    return Setup(model_arm(_rig_of(run)))


def truth_of(run: Run) -> dict[str, float]:
    """The simulator's own value of every parameter of a simulated run's arm, by name; nothing for a real one."""
    if not run.header.simulated or not run.header.rig_yaml:
        return {}
    config = _rig_of(run)
    if config.simulator is None:
        return {}
    base = rigid(config.simulator.base)
    x, y, z = (float(v) for v in base.translation_m)
    a, b, c = (float(v) for v in Rotation.from_matrix(base.rotation).as_rotvec())
    setup = Setup(true_arm(config), base_translation_m=(x, y, z), base_rotation_rad=(a, b, c))
    shown = {name: one.read(setup) for name, one in known(config.actuators).items() if not one.per_run}
    return {**shown, "sensor_filter_s": config.simulator.sensor.lag_ms * 1e-3}


def from_runs(archives: Sequence[Run], free: Sequence[str], priors: Mapping[str, Prior]) -> Fit:
    """Identify the arm of some whole runs, as `from_poses` does, from the arm of the first run's rig.

    Raises:
        NoData: no rig, or nothing in a run that can be used.
    """
    config = _rig_of(archives[0])
    return from_poses(config, shown(archives), free, priors)


def starting_rigs(first: Run, named: Sequence[str]) -> dict[str, RigConfig]:
    """The rigs that the search starts from, by name or file: those that are named, or else the first run's own.

    Raises:
        BadInput: a rig that is named.
        NoData: none is named, and the archive, of an import, has none.
    """
    return {name: load(name) for name in named} or {first.header.rig_name: _rig_of(first)}


def likeliest(
    rigs: Mapping[str, RigConfig],
    data: Sequence[Poses],
    free: Sequence[str],
    priors: Mapping[str, Prior],
    starts: int = 1,
) -> Fit:
    """Identify from each rig's arm and take what makes the runs likeliest; says so where there are several."""
    fits = {name: from_poses(config, data, free, priors, starts) for name, config in rigs.items()}
    best = max(fits, key=lambda name: fits[name].log_likelihood)
    for name, fit in fits.items() if len(fits) > 1 else ():
        taken = ", taken" if name == best else ""
        said = f"from {name}: log likelihood {fit.log_likelihood:.1f}, rms {1e3 * fit.rms_m:.3f} mm{taken}"
        console(stderr=True).print(said, soft_wrap=True)
    return fits[best]


def from_poses(
    config: RigConfig, data: Sequence[Poses], free: Sequence[str], priors: Mapping[str, Prior], starts: int = 1
) -> Fit:
    """Identify an arm from what runs show of it, beginning at a rig's.

    The sensors' accuracy, as the rig states it, is the prior of their offsets. Where a motion is to tell damping or
    density, the sensors' delay, which passes for either, is free with a prior of 5 ms.
    """
    chosen = tuple(free) or (DEFAULT_HOMOGENEOUS if config.model.variant.startswith("homogeneous") else DEFAULT)
    moving = any(one.moving for one in data) and {"damping_s", "density_kg_m3"} & set(chosen)
    if moving:
        chosen = (*chosen, *(name for name in SENSOR_TIMES if name not in chosen))
    accuracy = max(sensor.accuracy_bar for sensor in config.sensors) * PA_PER_BAR / 2
    believed = {"sensor_offsets": Prior(0.0, accuracy), **SENSOR_TIMES, **priors}
    return identify(data, Setup(model_arm(config)), chosen, believed, starts)


def show(fit: Fit, as_json: bool) -> None:
    """Estimates with their error bars or verdicts, and how well each run is met."""
    if as_json:
        typer.echo(json.dumps(plain_json(content(fit)), indent=2))
        return
    screen = console()
    table = Table(box=None, padding=(0, 2, 0, 0))
    for head in ("parameter", "value", "+-", "95 %", "unit", "run"):
        table.add_column(head, justify="left" if head in ("parameter", "unit", "run") else "right")
    for e in fit.estimates:
        if e.value is None or e.std is None or e.interval is None:
            others = f" ({', '.join(e.partners)})" if e.partners else ""
            table.add_row(
                e.name, "-", "", Text(f"{e.verdict.value}{others}; held at {e.used:.5g}", "yellow"), e.unit, e.run
            )
        else:
            low, high = e.interval
            table.add_row(e.name, f"{e.value:.6g}", f"{e.std:.2g}", f"{low:.5g} .. {high:.5g}", e.unit, e.run)
    screen.print(table)
    for run in fit.runs:
        kind = "motion" if run.moving else "plateaus"
        before, after = 1e3 * run.rms_before_m, 1e3 * run.rms_m
        screen.print(
            f"{run.run_id} ({kind}): rms {before:.3f} -> {after:.3f} mm, {run.outliers} outliers", soft_wrap=True
        )
    if fit.discrepancy_m:
        screen.print(f"the model is off by {1e3 * fit.discrepancy_m:.3f} mm per axis beyond the stated errors")
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
    try:
        save(predictions, (9, 2.6 * len(found)), file, found)
    except ValueError as fault:
        raise typer.BadParameter(f"{file}: {fault}", param_hint="--figure") from fault
    return file


def told(found: Sequence[Prediction]) -> None:
    """How well runs that were left out are predicted."""
    for one in found:
        how = ", under its measured wrench" if one.pulled else ""
        said = f"rms {1e3 * one.rms_before_m:.3f} -> {1e3 * one.rms_m:.3f} mm, "
        said += f"mean {1e3 * one.mean_m:.3f} mm, 95 % below {1e3 * one.most_m:.3f} mm"
        if one.lost:
            said += f"; {one.lost} of {len(one.error_m)} frames have no prediction and do not count"
        console(stderr=True).print(f"{one.run_id} (left out{how}): {said}", soft_wrap=True)


@contextmanager
def waiting(what: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar on the error stream, with the time left; call what it gives with (done, all)."""
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console(stderr=True), transient=True) as bar:
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


def _rig_of(run: Run) -> RigConfig:
    if not run.header.rig_yaml:
        raise NoData(
            f"{run.path}: the archive holds no rig; name one in the import's mapping (rig: FILE), or with --start"
        )
    return parse(run.header.rig_yaml, f"{run.path}: the rig's YAML")
