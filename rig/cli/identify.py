"""`rig identify`: from archives to the parameters of an arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rig.cli import completion
from rig.cli.address_space import EstimationCommand
from rig.cli.default_command import DefaultCommandGroup
from rig.cli.exit_status import FAULT
from rig.cli.options import Archives, AsJson, Every, Free, ParametersFile, Replace, Scheduler

if TYPE_CHECKING:
    from calibration.identify import Poses, Prior
    from calibration.identify.profile_likelihood import LikelihoodProfile
    from rig.identify.from_archives import OpenedRuns
    from runs.run import Run

app = typer.Typer(
    cls=DefaultCommandGroup,
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Identify an arm's parameters from runs. `rig identify RUN..` means `rig identify fit RUN..`.",
)

Priors = Annotated[
    list[str] | None,
    typer.Option("--prior", metavar="NAME=MEAN+-STD", help="Prior of a parameter; may be repeated."),
]
QuasiStatic = Annotated[
    bool, typer.Option("--quasi-static", help="Take every frame as an equilibrium, for slow imported motions.")
]
Store = Annotated[
    Path | None, typer.Option("--store", metavar="DIR", help="Keep finished fits in this folder, to resume.")
]
Between = Annotated[
    tuple[str, str] | None,
    typer.Option("--between", metavar="LAW_A LAW_B", help="Only these two laws, by the names of the table or shorter."),
]


@app.command(cls=EstimationCommand)
def fit(
    archives: Archives,
    free: Free = "",
    prior: Priors = None,
    start: Annotated[
        list[str] | None,
        typer.Option(
            metavar="RIG",
            autocompletion=completion.rigs,
            help="Initial rig, by name or file; default: the first run's. Of several, the likeliest is used.",
        ),
    ] = None,
    per_run: Annotated[
        str,
        typer.Option(
            "--per-run",
            metavar="NAME,..",
            help="Parameters or groups, free or not, with a value of their own in each run, as base,tool after "
            "a new mounting.",
        ),
    ] = "",
    starts: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Starting points of the search.",
            show_default="1; up to 4 where the first result is doubtful",
            min=1,
        ),
    ] = None,
    quasi_static: QuasiStatic = False,
    every: Every = 1,
    leave_out: Annotated[
        list[Path] | None,
        typer.Option(
            "--leave-out",
            metavar="RUN",
            help="Hold this run out and predict it; may be repeated.",
            autocompletion=completion.runs,
        ),
    ] = None,
    split_s: Annotated[
        float | None,
        typer.Option(metavar="S", help="Identify from each run's first S seconds, and predict the rest.", min=0),
    ] = None,
    profile: Annotated[
        bool, typer.Option("--profile", help="Profile-likelihood intervals of every shared parameter.")
    ] = False,
    bootstrap: Annotated[int, typer.Option(metavar="N", help="Bootstrap errors from N refits.", min=0)] = 0,
    scheduler: Scheduler = None,
    store: Store = None,
    to: ParametersFile = None,
    rig_file: Annotated[
        Path | None,
        typer.Option("--rig-file", metavar="FILE", help="Write the initial rig with the parameters applied."),
    ] = None,
    report: Annotated[Path | None, typer.Option(metavar="FILE", help="Write a report page (HTML).")] = None,
    replace: Replace = False,
    json: AsJson = False,
) -> None:
    """Estimate parameters with error bars, or report them as not identifiable. The default sub-command.

    --to FILE gets the parameters (YAML).

    Without --free, these are free: law, rpe_per_bar, base, sensor_offsets, and damping_s for dynamic runs.
    """
    from calibration.identify.bootstrap import bootstrap as refit
    from calibration.identify.parameters_document import write
    from calibration.identify.profile_likelihood import profiles
    from calibration.identify.report import write as write_report
    from calibration.identify.residual_dependence import residual_dependence
    from rig.cli import identification_output as output
    from rig.cli.progress import progress_bar, state_of
    from rig.identify import estimation, initial_setup
    from rig.identify.from_archives import from_data, read_data

    if not quasi_static:
        _refuse("needs --quasi-static", {"--every": every > 1})
    if not bootstrap:
        _refuse("nothing runs in parallel: add --bootstrap", {"--scheduler": scheduler, "--store": store})
    if bootstrap == 1:
        _refuse("at least two refits are needed", {"--bootstrap": bootstrap})
    if rig_file is not None and to is None:
        to = rig_file.with_suffix(".parameters.yaml")
    _check_places({"--report": report, "--to": to, "--rig-file": rig_file}, replace)
    priors = _priors(prior or [])
    opened = _opened(archives, leave_out or [], one_arm=bool(start))
    data = read_data(opened, start=start or [], quasi_static=quasi_static, every=every, split_s=split_s, read=_read)
    with state_of("searching") as show:
        done = from_data(data, free=_names(free), priors=priors, per_run=_names(per_run), starts=starts, progress=show)
    found, best, under = done.found, done.best, done.baseline
    if best.worse_than_start:
        output.failure(best)
        raise typer.Exit(FAULT)
    output.fits_by_start(found)
    predictions = done.predictions()
    dependences = residual_dependence(best)
    if json:
        output.as_json(best, under, predictions, dependences)
    else:
        output.estimates(best, dependences)
    output.prediction_errors(predictions, json)
    intervals: tuple[LikelihoodProfile, ...] = ()
    refits = None
    if profile:
        with progress_bar("profiles") as progress:
            intervals = profiles(best, progress=progress)
        output.profile_intervals(intervals, json)
    if bootstrap:
        with progress_bar("refitting") as progress:
            refits = refit(best, bootstrap, scheduler=scheduler, store=store, progress=progress)
        output.bootstrap_errors(best, refits, bootstrap, json)
    if report is not None:
        truth = initial_setup.truth_of(opened.seen[0])
        typer.echo(write_report(best, report, dependences, intervals, refits, predictions, truth), err=json)
    if to is not None:
        written = write(best, to, intervals, under)
        typer.echo(written, err=json)
        if rig_file is not None:
            rig_file.parent.mkdir(parents=True, exist_ok=True)
            rig_file.write_text(estimation.rig_with(found.rigs[found.best], written), encoding="utf-8")
            typer.echo(rig_file, err=json)


@app.command(cls=EstimationCommand)
def compare(
    archives: Archives,
    free: Free = "",
    prior: Priors = None,
    quasi_static: QuasiStatic = False,
    scheduler: Scheduler = None,
    store: Store = None,
    between: Between = None,
    json: AsJson = False,
) -> None:
    """Compare the paper's models by cross-validation over runs, as in its Table 3.

    A single run is divided into parts. Without --free, the base is free in every model. --between decides between two
    laws; then every uncertain number of the rig is estimated, too, as in `rig identify`.
    """
    from rig.cli import identification_output as output
    from rig.cli.progress import progress_bar
    from rig.identify import initial_setup, model_comparison

    priors = _priors(prior or [])
    seen = _opened(archives).seen
    start, data = initial_setup.setup_of(seen[0]), _read(seen, quasi_static)
    with progress_bar("fitting") as progress:
        config = initial_setup.rig_of(seen[0]) if between else None
        found = model_comparison.compare(start, data, _names(free), priors, scheduler, store, progress, between, config)
    output.comparison(found, json)


@app.command(cls=EstimationCommand)
def paper(archives: Archives, json: AsJson = False) -> None:
    """Identify as section 5.2 of the paper does, from its two extension experiments."""
    from rig.cli import identification_output as output
    from rig.reproduce.identification import estimate

    seen = _opened(archives).seen
    output.paper_estimates(estimate(seen), json)


def _opened(archives: Sequence[Path], leave_out: Sequence[Path] = (), *, one_arm: bool = False) -> OpenedRuns:
    """Open the runs to identify from, and those left out; print notes on them."""
    from rig.cli.identification_output import notes
    from rig.cli.run_names import resolve
    from rig.identify.from_archives import open_runs

    unseen = [resolve(name) for name in leave_out]
    opened = open_runs([resolve(name) for name in archives], unseen, one_arm=one_arm)
    notes(opened.notes)
    return opened


def _read(archives: Sequence[Run], quasi_static: bool) -> list[Poses]:
    """Read the data of the runs, with a progress bar."""
    from rig.cli.progress import progress_bar
    from rig.identify.estimation import read_poses

    if not archives:
        return []
    with progress_bar("reading") as progress:
        return read_poses(archives, quasi_static, progress)


def _names(free: str) -> list[str]:
    return [name.strip() for name in free.split(",") if name.strip()]


def _check_places(places: Mapping[str, Path | None], replace: bool) -> None:
    """Refuse output files that cannot be written or, without `replace`, that exist; before any computation."""
    from runs.overwriting import refuse_existing

    for option, place in places.items():
        if place is None:
            continue
        if place.is_dir():
            raise typer.BadParameter(f"{place}: name a file, not a folder", param_hint=option)
        if (above := next(folder for folder in place.parents if folder.exists())) and not above.is_dir():
            raise typer.BadParameter(f"{place}: {above} is a file, not a folder", param_hint=option)
        refuse_existing([place], replace=replace)


def _refuse(why: str, options: Mapping[str, object]) -> None:
    """Raise an error for those of the options that are set."""
    if given := [name for name, value in options.items() if value]:
        raise typer.BadParameter(why, param_hint=", ".join(given))


def _priors(items: Sequence[str]) -> dict[str, Prior]:
    """Parse priors of the form NAME=MEAN+-STD; return them by name."""
    from calibration.identify import Prior

    priors: dict[str, Prior] = {}
    for item in items:
        name, _, numbers = item.partition("=")
        mean, _, std = numbers.partition("+-")
        if name in priors:
            raise typer.BadParameter(f"{name} is given twice", param_hint="--prior")
        try:
            known = float(mean), float(std)
        except ValueError as fault:
            raise typer.BadParameter(f"'{item}' is not of the form NAME=MEAN+-STD", param_hint="--prior") from fault
        try:
            priors[name] = Prior(*known)
        except ValueError as fault:
            raise typer.BadParameter(f"'{item}': {fault}", param_hint="--prior") from fault
    return priors
