"""`rig identify`: from archives to the parameters of an arm."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rig.commands.options import Archives, AsJson


def identify(
    archives: Archives,
    free: Annotated[
        str, typer.Option(help="What is free, by commas: law, rpe_per_bar, base, tool, sensor_offsets, damping_s, ..")
    ] = "",
    prior: Annotated[
        list[str] | None, typer.Option(metavar="NAME=MEAN+-STD", help="What is known beforehand; may be repeated.")
    ] = None,
    start: Annotated[
        list[str] | None,
        typer.Option(
            metavar="RIG",
            help="Rig to start from, a name or a file, instead of the first run's; of several the likeliest wins.",
        ),
    ] = None,
    starts: Annotated[int, typer.Option(help="Starting points of the search.", min=1)] = 1,
    bootstrap: Annotated[int, typer.Option(metavar="N", help="Refit N times for a second opinion on +-.", min=0)] = 0,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="tcp://HOST:PORT", help="Dask scheduler for refits and --choose; default: all cores."),
    ] = None,
    store: Annotated[Path | None, typer.Option(metavar="DIR", help="Keep what is done there, to resume.")] = None,
    profile: Annotated[bool, typer.Option("--profile", help="Profile likelihood of every shared parameter.")] = False,
    leave_out: Annotated[
        list[Path] | None,
        typer.Option("--leave-out", "--predict", metavar="RUN", help="Predict this run, unseen; may be repeated."),
    ] = None,
    until: Annotated[
        float | None,
        typer.Option(metavar="S", help="Identify from each run's first S seconds, and predict the rest of it.", min=0),
    ] = None,
    quasi_static: Annotated[
        bool, typer.Option("--quasi-static", help="Take every frame as an equilibrium, as of slow imported motions.")
    ] = False,
    every: Annotated[
        int,
        typer.Option(
            metavar="N", help="Of --quasi-static, identify from every Nth frame: neighbours tell the same.", min=1
        ),
    ] = 1,
    choose: Annotated[
        bool, typer.Option("--choose", help="Compare the paper's models by predicting each run from the others.")
    ] = False,
    paper: Annotated[
        bool, typer.Option("--paper", help="The paper's own identification, from its two extension experiments.")
    ] = False,
    report: Annotated[Path | None, typer.Option(metavar="FILE", help="Write a report page (HTML).")] = None,
    figure: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw what was predicted, before and after (png, pdf, svg).")
    ] = None,
    to: Annotated[Path | None, typer.Option("--to", metavar="FILE", help="Write the parameters (YAML).")] = None,
    rig: Annotated[str, typer.Option("--rig", help="Rig that --rig-file starts from.")] = "mock",
    rig_file: Annotated[
        Path | None, typer.Option("--rig-file", metavar="FILE", help="Write the rig with the parameters in it.")
    ] = None,
    json: AsJson = False,
) -> None:
    """Find an arm's parameters from runs, with error bars, or say that the runs do not tell them."""
    import numpy as np

    import runs
    from calibration.identify import Prior, parted
    from calibration.identify.document import write
    from calibration.identify.prediction import predict
    from rig import identified
    from rig.listing import resolve

    if rig_file is not None and to is None:
        to = rig_file.with_suffix(".parameters.yaml")
    priors = {}
    for item in prior or []:
        name, _, numbers = item.partition("=")
        mean, _, std = numbers.partition("+-")
        try:
            priors[name] = Prior(float(mean), float(std))
        except ValueError as fault:
            raise typer.BadParameter(f"'{item}' is not of the form NAME=MEAN+-STD", param_hint="--prior") from fault
    if every > 1 and not quasi_static:
        raise typer.BadParameter(
            "only frames taken as equilibria can be left out: say --quasi-static", param_hint="--every"
        )
    if start and (choose or paper):
        raise typer.BadParameter("neither --choose nor --paper takes it", param_hint="--start")
    if (until is not None or figure is not None) and (choose or paper):
        raise typer.BadParameter("neither --choose nor --paper takes it", param_hint="--until, --figure")
    if figure is not None and until is None and not leave_out:
        raise typer.BadParameter("nothing is predicted: say --leave-out or --until", param_hint="--figure")
    names = [name.strip() for name in free.split(",") if name.strip()]
    unseen = [resolve(archive) for archive in leave_out or []]
    seen = [runs.open(path) for path in map(resolve, archives) if path not in unseen]
    if paper:
        from rig import paper_identified

        paper_identified.show(seen, json)
        return
    if choose:
        from rig import choosing

        choosing.show(seen, names, priors, quasi_static, json, scheduler, store)
        return
    if not seen:
        raise typer.BadParameter("every run is left out: nothing is left to identify from", param_hint="--leave-out")
    rigs = identified.starting_rigs(seen[0], start or [])
    data = identified.shown(seen, quasi_static)
    for name, config in rigs.items():
        if config.actuators != data[0].actuators:
            said = f"{name} has {config.actuators} actuators, the runs have {data[0].actuators}"
            raise typer.BadParameter(said, param_hint="--start")
    later = []
    if until is not None:
        parts = [parted(poses, until) for poses in data]
        data, later = [part[0] for part in parts], [part[1] for part in parts]
    data = [poses.only(np.arange(0, len(poses), every)) for poses in data]
    fit = identified.likeliest(rigs, data, names, priors, starts)
    identified.show(fit, json)
    later += [identified.poses(runs.open(path), quasi_static) for path in unseen]
    predictions = [predict(fit, poses) for poses in later]
    identified.told(predictions)
    profiles = identified.profiled(fit) if profile else ()
    refits = identified.second_opinion(fit, bootstrap, scheduler, store) if bootstrap else None
    if figure is not None:
        typer.echo(identified.draw_predictions(predictions, figure), err=json)
    if report is not None:
        from calibration.identify.report import write as write_report

        truth = identified.truth_of(seen[0])
        typer.echo(write_report(fit, report, profiles, refits, predictions, truth), err=json)
    if to is not None:
        written = write(fit, to, profiles)
        typer.echo(written, err=json)
        if rig_file is not None:
            rig_file.write_text(identified.rig_with(rig, written), encoding="utf-8")
            typer.echo(rig_file, err=json)
