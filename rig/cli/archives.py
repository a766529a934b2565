"""Commands on archives."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rig.cli.options import Archive, Archives, AsJson, Folder, Note, Operator, Parameters, Replace


def runs(
    folder: Annotated[Path, typer.Argument(metavar="DIR", file_okay=False)] = Path("data"),
    text: Annotated[str, typer.Option(help="Words to look for, in every field.")] = "",
    status: Annotated[str, typer.Option(help="finished, interrupted, aborted or recovered.")] = "",
    protocol: Annotated[str, typer.Option(help="Part of the protocol's name.")] = "",
    operator: Annotated[str, typer.Option(help="Part of the operator's name.")] = "",
    since: Annotated[str, typer.Option(help="From this date on, as 2026-11 or 2026-11-21.")] = "",
    until: Annotated[str, typer.Option(help="Up to and including this date.")] = "",
    error_above_mm: Annotated[float | None, typer.Option(help="Only those with a larger mean error.")] = None,
    json: AsJson = False,
) -> None:
    """List the archives of a folder, newest first."""
    from rig.cli import archive_output, recovery_offer
    from runs.catalogue import catalogue, search

    archive_output.check_search(folder, status, since, until, error_above_mm)
    recovery_offer.offer(folder)
    found = search(
        catalogue(folder),
        text,
        status=status,
        protocol=protocol,
        operator=operator,
        since=since,
        until=until,
        error_above_mm=error_above_mm,
    )
    archive_output.runs(found, folder, json)


def show(archive: Archive, json: AsJson = False) -> None:
    """Show the contents and the provenance of an archive."""
    from rig.cli import archive_output

    archive_output.show(archive, json)


def report(
    archives: Archives,
    to: Annotated[
        Path | None, typer.Option("--to", help="HTML file, or the figures' folder; default: beside the first archive.")
    ] = None,
    figures: Annotated[
        str | None, typer.Option("--figures", metavar="KIND", help="Instead, each figure as a file: pdf, png or svg.")
    ] = None,
    replace: Replace = False,
) -> None:
    """Write the report of one run, or of several side by side."""
    from protocols.problems import BadInputError, Problem
    from rig.cli.run_names import resolve
    from runs.report import figure_export
    from runs.report.page import default_path, write

    if figures is None and to is not None and (to.suffix.lower() != ".html" or to.is_dir()):
        raise BadInputError([Problem("--to", 0, 0, "", str(to), "a file whose name ends with .html")])
    found = [resolve(archive) for archive in archives]
    if figures is None:
        typer.echo(write(found, to, replace=replace))
        return
    for path in figure_export.write(found, to or default_path(found, "-figures"), figures, replace=replace):
        typer.echo(path)


def replay(
    archive: Archive,
    rig: Annotated[str | None, typer.Option("--rig", help="Another rig: calibration, model, material.")] = None,
    model: Annotated[str | None, typer.Option("--model", help="Another variant of the model.")] = None,
    parameters: Parameters = None,
    calibration: Annotated[
        list[Path] | None, typer.Option(metavar="FILE", help="A file of `rig calibrate`, to apply to the rig.")
    ] = None,
    out: Folder = Path("data"),
) -> None:
    """Run vision and model again on a run's stored pictures and pressures."""
    from rig.cli.run_names import resolve
    from rig.config.model_variant import variant_named
    from rig.experiment.replay import replay as observe_again
    from runs.run import Run

    typer.echo(
        observe_again(Run(resolve(archive)), out, rig, variant_named(model), parameters, tuple(calibration or ()))
    )


def export(
    archive: Archive,
    to: Annotated[str, typer.Option("--to", help="csv, mat, nc, mcap, or yaml: what it was made from.")] = "csv",
    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Default: beside the archive.")] = None,
    replace: Replace = False,
) -> None:
    """Write an archive in another format."""
    from rig.cli.run_names import resolve
    from runs.export.exporters import export as write

    for path in write(resolve(archive), to, out, replace=replace):
        typer.echo(path)


def import_(
    data: Annotated[list[Path], typer.Argument(metavar="DATA..", help="CSV or .mat files.", dir_okay=False)],
    mapping: Annotated[
        Path,
        typer.Option("--mapping", metavar="FILE", help="YAML: which column is what; docs/reference/import-mapping.md"),
    ],
    out: Folder = Path("data"),
    operator: Operator = "",
    note: Note = "",
) -> None:
    """Convert foreign measurements to archives."""
    from rig.importing import import_table

    for file in data:
        made = import_table(file, mapping, out, operator, note)
        for warning in made.warnings:
            typer.echo(f"warning: {file}: {warning}", err=True)
        typer.echo(made.archive)


def recover(
    folder: Annotated[Path, typer.Argument(metavar="DIR", file_okay=False)] = Path("data"),
) -> None:
    """Turn the journals of runs that were killed into archives."""
    from rig.cli import archive_output

    archive_output.recover(folder)
