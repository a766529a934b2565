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
    starts: Annotated[int, typer.Option(help="Starting points of the search.", min=1)] = 1,
    bootstrap: Annotated[int, typer.Option(metavar="N", help="Refit N times for a second opinion on +-.", min=0)] = 0,
    scheduler: Annotated[
        str | None, typer.Option(metavar="tcp://HOST:PORT", help="Dask scheduler for the refits; default: all cores.")
    ] = None,
    store: Annotated[Path | None, typer.Option(metavar="DIR", help="Keep finished refits there, to resume.")] = None,
    to: Annotated[Path | None, typer.Option("--to", metavar="FILE", help="Write the parameters (YAML).")] = None,
    rig: Annotated[str, typer.Option("--rig", help="Rig that --rig-file starts from.")] = "mock",
    rig_file: Annotated[
        Path | None, typer.Option("--rig-file", metavar="FILE", help="Write the rig with the parameters in it.")
    ] = None,
    json: AsJson = False,
) -> None:
    """Find an arm's parameters from runs, with error bars, or say that the runs do not tell them."""
    import runs
    from calibration.identify import Prior
    from calibration.identify.document import write
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
    names = [name.strip() for name in free.split(",") if name.strip()]
    fit = identified.from_runs([runs.open(resolve(archive)) for archive in archives], names, priors, starts)
    identified.show(fit, json)
    if bootstrap:
        identified.second_opinion(fit, bootstrap, scheduler, store)
    if to is not None:
        written = write(fit, to)
        typer.echo(written, err=json)
        if rig_file is not None:
            rig_file.write_text(identified.rig_with(rig, written), encoding="utf-8")
            typer.echo(rig_file, err=json)
