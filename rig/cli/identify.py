"""`rig identify`: from archives to the parameters of an arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rig.cli.options import Archives, AsJson, Replace

if TYPE_CHECKING:
    from calibration.identify import Prior

FIGURES = (".png", ".pdf", ".svg")


def identify(
    archives: Archives,
    free: Annotated[
        str,
        typer.Option(
            help="Free parameters, separated by commas: tool, cap_mass_kg, .. Default: law, rpe_per_bar, base, "
            "sensor_offsets, and damping_s for dynamic runs.",
        ),
    ] = "",
    prior: Annotated[
        list[str] | None, typer.Option(metavar="NAME=MEAN+-STD", help="Prior of a parameter; may be repeated.")
    ] = None,
    start: Annotated[
        list[str] | None,
        typer.Option(
            metavar="RIG",
            help="Initial rig, by name or file; default: the first run's. Of several, the likeliest is used.",
        ),
    ] = None,
    starts: Annotated[int, typer.Option(help="Starting points of the search.", min=1)] = 1,
    bootstrap: Annotated[int, typer.Option(metavar="N", help="Bootstrap errors from N refits.", min=0)] = 0,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="tcp://HOST:PORT", help="Dask scheduler for refits and --choose; default: all cores."),
    ] = None,
    store: Annotated[Path | None, typer.Option(metavar="DIR", help="Store finished refits there, to resume.")] = None,
    profile: Annotated[
        bool, typer.Option("--profile", help="Profile-likelihood intervals of every shared parameter.")
    ] = False,
    leave_out: Annotated[
        list[Path] | None,
        typer.Option(
            "--leave-out", "--predict", metavar="RUN", help="Hold this run out and predict it; may be repeated."
        ),
    ] = None,
    until: Annotated[
        float | None,
        typer.Option(metavar="S", help="Identify from each run's first S seconds, and predict the rest.", min=0),
    ] = None,
    quasi_static: Annotated[
        bool, typer.Option("--quasi-static", help="Take every frame as an equilibrium, for slow imported motions.")
    ] = False,
    every: Annotated[
        int,
        typer.Option(metavar="N", help="With --quasi-static, identify from every Nth frame.", min=1),
    ] = 1,
    choose: Annotated[
        bool, typer.Option("--choose", help="Compare the paper's models by cross-validation over runs.")
    ] = False,
    paper: Annotated[
        bool, typer.Option("--paper", help="The paper's own identification, from its two extension experiments.")
    ] = False,
    report: Annotated[Path | None, typer.Option(metavar="FILE", help="Write a report page (HTML).")] = None,
    figure: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw the predictions before and after (png, pdf, svg).")
    ] = None,
    to: Annotated[Path | None, typer.Option("--to", metavar="FILE", help="Write the parameters (YAML).")] = None,
    rig: Annotated[
        str | None, typer.Option("--rig", help="Rig to which --rig-file adds the parameters; default: the initial rig.")
    ] = None,
    rig_file: Annotated[
        Path | None, typer.Option("--rig-file", metavar="FILE", help="Write the rig with the parameters applied.")
    ] = None,
    replace: Replace = False,
    json: AsJson = False,
) -> None:
    """Identify an arm's parameters from runs, with error bars, or report them as not identifiable."""
    import numpy as np

    from calibration.identify import split_at
    from calibration.identify.held_out_prediction import predict
    from calibration.identify.parameters_document import write
    from rig.identify import estimation, initial_setup

    whole = {
        "--start": start, "--starts": starts > 1, "--bootstrap": bootstrap, "--profile": profile,
        "--leave-out": leave_out, "--until": until is not None, "--every": every > 1, "--report": report,
        "--figure": figure, "--to": to, "--rig-file": rig_file,
    }  # fmt: skip
    shared = {
        "--free": free, "--prior": prior, "--quasi-static": quasi_static, "--scheduler": scheduler, "--store": store,
    }  # fmt: skip
    if choose or paper:
        _refuse("not valid with --choose or --paper", whole)
    if paper:
        _refuse("not valid with --paper", {**shared, "--choose": choose})
    if not quasi_static:
        _refuse("needs --quasi-static", {"--every": every > 1})
    if until is None and not leave_out:
        _refuse("nothing is predicted: add --leave-out or --until", {"--figure": figure})
    if not (choose or bootstrap):
        _refuse("nothing runs in parallel: add --bootstrap or --choose", {"--scheduler": scheduler, "--store": store})
    if rig_file is None:
        _refuse("needs --rig-file; --start sets the initial rig of the search", {"--rig": rig})
    elif to is None:
        to = rig_file.with_suffix(".parameters.yaml")
    if bootstrap == 1:
        _refuse("at least two refits are needed", {"--bootstrap": bootstrap})
    _check_places({"--report": report, "--figure": figure, "--to": to, "--rig-file": rig_file}, replace)
    priors = _priors(prior or [])
    names = [name.strip() for name in free.split(",") if name.strip()]
    unseen = initial_setup.open_archives(leave_out or [])
    left_out = {run.sha256 for run in unseen}
    seen = [run for run in initial_setup.open_archives(archives) if run.sha256 not in left_out]
    if not seen:
        raise typer.BadParameter("every run is left out: nothing is left to identify from", param_hint="--leave-out")
    initial_setup.check_alike([*seen, *unseen], one_arm=bool(start))
    if paper:
        from rig.reproduce import identification as by_the_paper

        by_the_paper.print_estimates(seen, json)
        return
    if choose:
        from rig.identify import model_comparison

        model_comparison.comparison_lines(seen, names, priors, quasi_static, json, scheduler, store)
        return
    rigs = initial_setup.starting_rigs(seen[0], start or [])
    data = estimation.read_poses(seen, quasi_static)
    for name, initial in rigs.items():
        if initial.config.actuators != data[0].actuators:
            reason = f"{name} has {initial.config.actuators} actuators, the runs have {data[0].actuators}"
            raise typer.BadParameter(reason, param_hint="--start")
    base = None if rig is None else initial_setup.InitialSetup.named(rig)
    if base is not None and (differences := initial_setup.geometry_differences(base, rigs.values())):
        raise typer.BadParameter(f"{rig} has another arm than the initial rig: {differences}", param_hint="--rig")
    later = estimation.read_poses(unseen, quasi_static)
    for poses in later:
        if poses.actuators != data[0].actuators:
            reason = f"{poses.run_id} is of {poses.actuators} actuators, the others are of {data[0].actuators}"
            raise typer.BadParameter(reason, param_hint="--leave-out")
    if until is not None:
        parts = [split_at(poses, until) for poses in data]
        data, later = [part[0] for part in parts], [part[1] for part in parts] + later
    data = [poses.only(np.arange(0, len(poses), every)) for poses in data]
    chosen_rig, fit = estimation.most_likely_fit(rigs, data, names, priors, starts)
    under = initial_setup.baseline_geometry(seen[0], fit.start, from_recorded_rig=not start)
    estimation.print_estimates(fit, json, under)
    predictions = [predict(fit, poses) for poses in later]
    estimation.print_prediction_errors(predictions)
    profiles = estimation.profile_likelihoods(fit) if profile else ()
    refits = estimation.bootstrap_errors(fit, bootstrap, scheduler, store) if bootstrap else None
    if figure is not None:
        typer.echo(estimation.draw_predictions(predictions, figure), err=json)
    if report is not None:
        from calibration.identify.report import write as write_report

        truth = initial_setup.truth_of(seen[0])
        typer.echo(write_report(fit, report, profiles, refits, predictions, truth), err=json)
    if to is not None:
        written = write(fit, to, profiles, under)
        typer.echo(written, err=json)
        if rig_file is not None:
            rig_file.parent.mkdir(parents=True, exist_ok=True)
            rig_file.write_text(estimation.rig_with(base or chosen_rig, written), encoding="utf-8")
            typer.echo(rig_file, err=json)


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
        if option == "--figure" and place.suffix.lower() not in FIGURES:
            raise typer.BadParameter(f"{place}: a name that ends with .png, .pdf or .svg", param_hint=option)
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
