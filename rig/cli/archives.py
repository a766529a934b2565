"""Commands on archives."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from rig.cli import options
from rig.cli.completion import DATA


@contextmanager
def _read_as_it_is(archives: Sequence[Path], force: bool) -> Iterator[None]:
    """Let a command read damaged archives, as far as it comes; without `force` without effect."""
    from rig.cli.expected_errors import is_expected
    from runs.archive import digest

    for path in archives if force else ():
        digest.accept(path)
    try:
        yield
    except Exception as error:
        if not force or is_expected(error):
            raise
        raise digest.DamagedArchiveError(
            f"the archive cannot be read so far: {type(error).__name__}: {error}"
        ) from error


def runs(
    folder: Annotated[Path, typer.Argument(metavar="DIR", file_okay=False)] = DATA,
    text: Annotated[str, typer.Option(help="Words to find in any field, such as protocol, status or operator.")] = "",
    since: Annotated[str, typer.Option(help="From this date on, as 2026-11 or 2026-11-21.")] = "",
    until: Annotated[str, typer.Option(help="Up to and including this date.")] = "",
    tag: Annotated[str, typer.Option(help="Only those with this tag.")] = "",
    specimen: Annotated[str, typer.Option(help="Only those of this specimen, with the sum of pressure cycles.")] = "",
    study: Annotated[str, typer.Option(help="Only those of this study.")] = "",
    json: options.AsJson = False,
) -> None:
    """List the archives of a folder, newest first."""
    from rig.cli import archive_output
    from rig.cli.run_names import report_interrupted
    from runs.catalogue import catalogue, search, specimen_cycles

    archive_output.check_search(folder, since, until)
    report_interrupted(folder)
    entries = catalogue(folder)
    found = search(entries, text, since=since, until=until, tag=tag, specimen=specimen, study=study)
    archive_output.runs(found, folder, json)
    if specimen and found and not json:
        archive_output.cycles(specimen, *specimen_cycles(entries, specimen))


def show(archive: options.Archive, force: options.Force = False, json: options.AsJson = False) -> None:
    """Show the contents and the provenance of an archive."""
    from rig.cli import archive_output
    from rig.cli.run_names import resolve

    path = resolve(archive)
    with _read_as_it_is([path], force):
        archive_output.show(path, json)


def report(
    archives: options.Archives,
    figures: Annotated[bool, typer.Option("--figures", help="Write each figure as a file, for print.")] = False,
    format_: options.Format = "pdf",
    width_mm: Annotated[float, typer.Option("--width-mm", help="Width of the figures [mm].")] = 88.0,
    to: options.ReportFile = None,
    out: options.OptionalFolder = None,
    replace: options.Replace = False,
    force: options.Force = False,
) -> None:
    """Write the report of one run, or what differs between several.

    --figures writes figures in the width of a column instead, into --out: pdf, png or svg, and CSV files with their
    data.
    """
    from protocols.problems import Problem, bad_input, raise_all
    from rig.cli.run_names import resolve
    from runs.report import figure_export
    from runs.report.page import default_path, write

    misplaced = (
        [("--to", to, "no --to beside --figures: use --out")]
        if figures
        else [
            ("--out", out, "--out is for --figures: use --to"),
            ("--format", format_ if format_ != "pdf" else None, "--format is for --figures"),
            ("--width-mm", width_mm if width_mm != 88.0 else None, "--width-mm is for --figures"),
        ]
    )
    problems = [Problem(option, 0, 0, "", str(given), expected) for option, given, expected in misplaced if given]
    raise_all(problems)
    if to is not None and to.suffix.lower() != ".html":
        raise bad_input("--to", str(to), "a file whose name ends with .html")
    found = [resolve(archive) for archive in archives]
    with _read_as_it_is(found, force):
        if not figures:
            typer.echo(write(found, to, replace=replace))
            return
        folder = out or default_path(found, "-figures")
        for path in figure_export.write(found, folder, format_, width_mm=width_mm, replace=replace):
            typer.echo(path)


def replay(
    archive: options.Archive,
    rig: options.RecordedRig = None,
    model: options.Variant = None,
    parameters: options.Parameters = None,
    calibration: options.Calibrations = None,
    out: options.Folder = DATA,
) -> None:
    """Run vision and model again on a run's stored pictures and pressures, also with another rig."""
    from rig.cli.run_names import resolve
    from rig.config.sections import variant_named
    from rig.experiment.replay import replay as observe_again
    from runs.run import Run

    typer.echo(
        observe_again(Run(resolve(archive)), out, rig, variant_named(model), parameters, tuple(calibration or ()))
    )


def export(
    archive: options.Archive,
    format_: options.Format = "csv",
    out: options.OptionalFolder = None,
    replace: options.Replace = False,
    force: options.Force = False,
) -> None:
    """Write an archive in another format: csv, mat, mcap, or yaml for the inputs of the run."""
    from rig.cli.run_names import resolve
    from runs.export.exporters import export as write

    source = resolve(archive)
    with _read_as_it_is([source], force):
        for path in write(source, format_, out, replace=replace):
            typer.echo(path)


def import_(
    data: Annotated[list[Path], typer.Argument(metavar="DATA..", help="CSV or .mat files.", dir_okay=False)],
    mapping: Annotated[
        Path,
        typer.Option("--mapping", metavar="FILE", help="YAML: which column is what; docs/reference/import-mapping.md"),
    ],
    out: options.Folder = DATA,
    operator: options.Operator = "",
    note: options.Note = "",
) -> None:
    """Convert foreign measurements to archives."""
    from rig.importing import import_table

    for file in data:
        made = import_table(file, mapping, out, operator, note)
        for warning in made.warnings:
            typer.echo(f"warning: {file}: {warning}", err=True)
        typer.echo(made.archive)


def recover(
    folder: Annotated[Path, typer.Argument(metavar="DIR", file_okay=False)] = DATA,
) -> None:
    """Turn the journals of runs that were killed into archives."""
    from rig.cli import archive_output

    archive_output.recover(folder)


def note(
    archive: options.Archive, text: Annotated[str, typer.Argument(metavar="TEXT", help="The note, in quotes.")]
) -> None:
    """Add a note to a run; the archive stays as it is."""
    from rig.cli.run_names import resolve
    from runs.annotations import add_note

    typer.echo(add_note(resolve(archive), text))


def tag(
    archive: options.Archive,
    tags: Annotated[list[str], typer.Argument(metavar="TAG..", help="One or several words, as bad.")],
    remove: Annotated[bool, typer.Option("--remove", help="Remove these tags.")] = False,
) -> None:
    """Add tags to a run, or remove them; the archive stays as it is."""
    from rig.cli.run_names import resolve
    from runs.annotations import add_tags, remove_tags

    typer.echo((remove_tags if remove else add_tags)(resolve(archive), tags))


def publish(
    archives: options.Archives,
    to: options.OutputFile = Path("crate.zip"),
    title: Annotated[str, typer.Option(help="Title; default: that of the run.", show_default=False)] = "",
    creator: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Creator, as 'Ada Lovelace 0000-0002-1825-0097'; may be repeated."),
    ] = None,
    licence: Annotated[str, typer.Option(metavar="SPDX", help="Licence of the data, as CC-BY-4.0.")] = "",
    replace: options.Replace = False,
) -> None:
    """Write runs as a crate (RO-Crate) for a data repository: metadata, checksums, licence, fields."""
    from protocols.problems import bad_input
    from rig.cli.run_names import resolve
    from rig.publish.crate import remaining, write
    from rig.publish.description import describe
    from runs.run import Run

    if to.suffix.lower() != ".zip":
        raise bad_input("--to", str(to), "a file whose name ends with .zip")
    runs = [Run(path) for path in dict.fromkeys(resolve(archive) for archive in archives)]
    if (names := [run.path.name for run in runs]) and len(set(names)) < len(names):
        raise bad_input("RUN", ", ".join(names), "archives of different file names")
    description = describe(runs, title, creator or (), licence)
    typer.echo(write(runs, description, to, replace=replace))
    for sentence in remaining(description):
        typer.echo(sentence, err=True)
