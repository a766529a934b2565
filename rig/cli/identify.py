"""`rig identify`: from archives to the parameters of an arm."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from rig.cli import completion
from rig.cli.commands import DefaultCommandGroup
from rig.cli.options import Archives, AsJson, Every, Free, ParametersFile, Replace, Scheduler

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


InitialRig = Annotated[
    str | None,
    typer.Option(
        "--start",
        metavar="RIG",
        autocompletion=completion.rigs,
        help="Initial rig, by name or file; default: the first run's.",
    ),
]
PerRun = Annotated[
    str,
    typer.Option(
        "--per-run",
        metavar="NAME,..",
        help="Parameters or groups, free or not, with a value of their own in each run, as base,tool after "
        "a new mounting.",
    ),
]
NoiseName = Annotated[
    str,
    typer.Option(
        "--noise",
        metavar="NAME",
        help="adaptive: extra errors, correlation and outliers by the residuals; white: weighted least squares "
        "with the stated errors alone.",
    ),
]
Export = Annotated[
    Path | None,
    typer.Option(
        "--export", metavar="FILE", help="Write residuals, derivatives, covariances and priors, to check the fit (NPZ)."
    ),
]
LeftOut = Annotated[
    list[Path] | None,
    typer.Option(
        "--leave-out",
        metavar="RUN",
        help="Hold this run out and predict it; may be repeated.",
        autocompletion=completion.runs,
    ),
]
SplitTime = Annotated[
    float | None,
    typer.Option(
        "--split-s", metavar="S", help="Identify from each run's first S seconds, and predict the rest.", min=0
    ),
]
IdentifiedRig = Annotated[
    Path | None,
    typer.Option("--rig-file", metavar="FILE", help="Write the initial rig with the parameters applied."),
]
ReportPage = Annotated[Path | None, typer.Option("--report", metavar="FILE", help="Write a report page (HTML).")]


@app.command()
def fit(
    archives: Archives,
    free: Free = "",
    prior: Priors = None,
    start: InitialRig = None,
    per_run: PerRun = "",
    noise: NoiseName = "adaptive",
    quasi_static: QuasiStatic = False,
    every: Every = 1,
    leave_out: LeftOut = None,
    split_s: SplitTime = None,
    to: ParametersFile = None,
    rig_file: IdentifiedRig = None,
    report: ReportPage = None,
    export: Export = None,
    replace: Replace = False,
    json: AsJson = False,
) -> None:
    """Estimate parameters with error bars, or report them as not identifiable. The default sub-command.

    --to FILE gets the parameters (YAML).

    Without --free, these are free: law, rpe_per_bar, base, sensor_offsets, and damping_s for dynamic runs.
    """
    from calibration.identify.fitting.export import write as write_export
    from calibration.identify.presentation.parameters_document import write
    from calibration.identify.presentation.report import write as write_report
    from rig.cli import identification_output as output
    from rig.cli.assignments import names
    from rig.cli.progress import state_of
    from rig.identify.estimation import rig_with
    from rig.identify.from_archives import from_data, read_data
    from rig.identify.initial_setup import truth_of
    from rig.identify.warnings import warnings_of
    from runs.overwriting import refuse_existing, write_text

    if not quasi_static:
        _refuse("needs --quasi-static", {"--every": every > 1})
    if rig_file is not None and to is None:
        to = rig_file.with_suffix(".parameters.yaml")
    refuse_existing(filter(None, (report, to, rig_file, export)), replace=replace)
    priors = output.priors_of(prior or [])
    opened = output.opened(archives, leave_out or [], one_arm=start is not None)
    data = read_data(opened, start=start, quasi_static=quasi_static, every=every, split_s=split_s, read=output.read)
    with state_of("searching") as show:
        done = from_data(data, free=names(free), priors=priors, per_run=names(per_run), noise=noise, progress=show)
    output.identification(done, warnings_of(done), json)
    if report is not None:
        truth = truth_of(opened.seen[0])
        typer.echo(write_report(done.fit, report, warnings_of(done), done.predictions, truth), err=json)
    if export is not None:
        typer.echo(write_export(done.fit, export), err=json)
    if to is not None:
        written = write(done.fit, to, done.baseline)
        typer.echo(written, err=json)
        if rig_file is not None:
            write_text(rig_file, rig_with(done.rig, written))
            typer.echo(rig_file, err=json)


@app.command()
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
    from rig.cli.assignments import names
    from rig.cli.progress import progress_bar
    from rig.identify import initial_setup, model_comparison

    priors = output.priors_of(prior or [])
    seen = output.opened(archives).seen
    start, data = initial_setup.setup_of(seen[0]), output.read(seen, quasi_static)
    with progress_bar("fitting") as progress:
        config = initial_setup.rig_of(seen[0]) if between else None
        found = model_comparison.compare(start, data, names(free), priors, scheduler, store, progress, between, config)
    output.comparison(found, json)


def _refuse(why: str, options: Mapping[str, object]) -> None:
    """Raise an error for those of the options that are set."""
    if given := [name for name, value in options.items() if value]:
        raise typer.BadParameter(why, param_hint=", ".join(given))
