"""The `rig` command: parses, calls, prints. Heavy modules are imported where they are used."""

from __future__ import annotations

import gc
import io
import sys
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup

from rig.cli import archives, calibrate, identify, init, reproduce
from rig.cli.options import AsJson, Fast, Folder, Note, Operator, Parameters, RigName, Seed, Variant, VentedRig, Yes
from rig.cli.printable import printable_streams

DONE, FAULT, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
GARBAGE_OBJECTS = 50_000


class PlainErrors(TyperGroup):
    """Turns the errors a user can cause into one message and an exit status, never a traceback."""

    def invoke(self, ctx: Any) -> Any:
        """Run a command."""
        try:
            return super().invoke(ctx)
        except (typer.Exit, typer.Abort):
            raise
        except KeyboardInterrupt:
            _fail("interrupted", INTERRUPTED)
        except Exception as error:
            status = _status(error)
            if status is None:
                raise
            _fail(_said(error), status)


def _said(error: Exception) -> str:
    """An error in words: the system's without its number."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if isinstance(error.filename, str) else error.strerror
    if isinstance(error, MemoryError):
        return f"not enough memory: {error}" if str(error) else "not enough memory"
    return str(error)


def _status(error: Exception) -> int | None:
    """Exit status of an expected error; None for one that is a bug."""
    from protocols import BadInputError

    if isinstance(error, BadInputError):
        return BAD_INPUT  # the usual one: said before the rooms of all the others are imported
    from rig.execution.plan import StartError, StoppedError
    from rig.hardware.cameras.base import CameraError
    from rig.hardware.cards.base import CardError
    from runs.journal.append_only_file import JournalError

    if isinstance(error, StoppedError):
        return INTERRUPTED
    if isinstance(error, CardError | CameraError | StartError | JournalError | OSError | MemoryError):
        return FAULT  # where memory is short, what follows cannot be imported
    from calibration.camera import CalibrationError
    from calibration.dlt import DLTError
    from calibration.identify import NoDataError, UnknownParameter
    from calibration.identify.parallel_map import NoClusterError, WorkersDieError
    from calibration.identify.recursive_estimator import NotEstimableError
    from calibration.views import ViewsError
    from rig.calibrate.bench_driver import TrippedError
    from runs.archive.writer import ArchiveError
    from runs.export.exporters import ExportError
    from runs.overwriting import WouldOverwrite

    if isinstance(error, NoDataError | UnknownParameter | NotEstimableError):
        return BAD_INPUT
    if isinstance(error, ArchiveError | ExportError | CalibrationError | DLTError | ViewsError | WouldOverwrite):
        return BAD_INPUT
    if isinstance(error, NoClusterError | WorkersDieError | TrippedError):
        return FAULT
    return None


def _fail(message: str, status: int) -> NoReturn:
    typer.echo(message, err=True)
    raise typer.Exit(status)


app = typer.Typer(
    cls=PlainErrors,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"color": True},  # what looks like colour is shown by PrintableStream, not cut out
    rich_markup_mode=None,  # a unit in square brackets is no markup
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"softrig {version('softrig')}")
        raise typer.Exit(DONE)


@app.callback()
def program(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Run a soft-robotics experiment: valves, pressures, camera, Cosserat rod model, archive."""


LOCAL, LIVE_PORT = "127.0.0.1", 8090
Listen = Annotated[
    str, typer.Option(metavar="ADDRESS", help="Address of this machine to serve the page on, for others to reach.")
]
Port = Annotated[int, typer.Option(help="First port to try for the page; 0 for any that is free.", min=0, max=65535)]
ProtocolName = Annotated[str, typer.Argument(metavar="NAME|FILE", help="Named protocol, or a YAML file.")]


@app.command()
def run(
    protocol: ProtocolName,
    rig: RigName = None,
    fast: Fast = False,
    seed: Seed = 0,
    out: Folder = Path("data"),
    model: Variant = None,
    parameters: Parameters = None,
    operator: Operator = "",
    note: Note = "",
    yes: Yes = False,
    report: Annotated[bool, typer.Option(help="Write the HTML report.")] = True,
    adapt: Annotated[
        bool, typer.Option("--adapt", help="Find the arm's parameters meanwhile; never controls.")
    ] = False,
    free: Annotated[str, typer.Option(help="What --adapt finds, by commas, as for rig identify.")] = "",
    live: Annotated[bool, typer.Option("--live", help="Show the run in the browser, too.")] = False,
    listen: Listen = LOCAL,
    port: Port = LIVE_PORT,
    json: AsJson = False,
) -> None:
    """Run a protocol and leave an archive with a report."""
    from rig.cli import recovery_offer, run_output
    from rig.cli.signals import StopSignals
    from rig.cli.terminal import Terminal
    from rig.config.loader import chosen_rig
    from rig.experiment import run as experiment

    if live and fast:
        _fail(
            "--live shows a run in real time; leave out --fast, or play the archive afterwards: rig live RUN", BAD_INPUT
        )
    if not live and (listen, port) != (LOCAL, LIVE_PORT):
        _fail("--listen and --port say where --live shows the run; say --live, too", BAD_INPUT)
    if free and not adapt:
        _fail("--free says what --adapt finds; say --adapt, too", BAD_INPUT)
    request = experiment.request(
        protocol,
        chosen_rig(rig),
        adapt=[name.strip() for name in free.split(",") if name.strip()] if adapt else None,
        folder=out,
        fast=fast,
        seed=seed,
        variant=model,
        parameters=parameters,
        operator=operator,
        notes=note,
        report=report,
    )
    decided = experiment.plan(request)
    console = run_output.console(stderr=json)
    recovery_offer.offer(out, ask=not yes)
    console.print(run_output.check_screen(request, decided))
    if not yes and not run_output.confirm(console):
        _fail("not armed", BAD_INPUT)
    page: AbstractContextManager[None] = nullcontext()
    if live:
        from rig.live.launch import live_page_of_this_run

        page = live_page_of_this_run(listen, port, lambda line: console.print(line, soft_wrap=True))
    with (
        page,
        StopSignals() as signals,
        Terminal(console, lambda: signals.reason, run_output.title(request)) as terminal,
    ):
        result = experiment.run(request, decided, terminal)
    run_output.last_screen(console, result)
    if json:
        typer.echo(run_output.result_json(result))
    raise typer.Exit(run_output.exit_status(result))


@app.command()
def check(protocol: ProtocolName, rig: RigName = None, json: AsJson = False) -> None:
    """Check a protocol against a rig, without touching hardware."""
    from rig.cli import run_output
    from rig.config.loader import chosen_rig
    from rig.experiment import run as experiment

    request = experiment.request(protocol, chosen_rig(rig))
    decided = experiment.plan(request)
    if json:
        typer.echo(run_output.check_json(request, decided))
    else:
        console = run_output.console()
        console.print(run_output.check_screen(request, decided))
        console.print(run_output.sketch(decided, console.width))
        console.print(run_output.verdict(request), soft_wrap=True)


@app.command()
def protocols() -> None:
    """List the named protocols."""
    from protocols import named

    for name, title in named():
        typer.echo(f"{name:22s}{title}")


@app.command()
def doctor(
    rig: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE",
            help="Check the cards of this rig, too. Default: $SOFTRIG_RIG, else ./softrig.yaml, else none.",
        ),
    ] = None,
    out: Folder = Path("data"),
    json: AsJson = False,
) -> None:
    """Say what this machine offers a rig, and what to do about what is missing."""
    from rig.cli import run_output
    from rig.config.loader import load, named_rig
    from rig.doctor import examine

    chosen = named_rig(rig)
    findings = examine(out, load(chosen.name) if chosen else None)
    if json:
        typer.echo(run_output.findings_json(findings))
    else:
        run_output.console().print(run_output.findings_table(findings))
    raise typer.Exit(FAULT if any(f.verdict == "missing" for f in findings) else DONE)


@app.command()
def vent(rig: VentedRig = None) -> None:
    """Vent every chamber of a rig, whoever uses it; a running experiment ends.

    Where no rig is named, vents the rigs of this user's running experiments.
    """
    from rig.realtime.scheduling import raise_priority

    raise_priority()  # before what takes long to import: a busy machine must not keep the valves waiting
    from rig.cli.vent import vent as vent_rigs

    vent_rigs(rig)


@app.command()
def simulate(
    protocol: ProtocolName,
    rig: RigName = None,
    model: Variant = None,
    parameters: Parameters = None,
    static: Annotated[bool, typer.Option("--static", help="Statics at every set-point instead of dynamics.")] = False,
    out: Folder = Path("data"),
) -> None:
    """Run the model alone, driven by the protocol's set-points; leaves an archive of the same layout."""
    from rig.config.loader import chosen_rig
    from rig.experiment import run as experiment
    from rig.experiment.simulate import simulate as run_model

    request = experiment.request(protocol, chosen_rig(rig), folder=out, variant=model, parameters=parameters)
    typer.echo(run_model(request, experiment.plan(request), static))


@app.command()
def live(
    archive: Annotated[
        Path | None, typer.Argument(metavar="[RUN]", help="Archive to play; without it, the run that goes.")
    ] = None,
    pid: Annotated[int | None, typer.Option(help="Process of the run to watch, where several go.")] = None,
    listen: Listen = LOCAL,
    port: Port = LIVE_PORT,
) -> None:
    """Show a run that goes in the browser, or play an archive."""
    from rig.cli import run_output
    from rig.cli.archive_output import resolve
    from rig.live.launch import show

    if archive is not None and pid is not None:
        _fail("--pid names a run that goes; leave it out to play an archive", BAD_INPUT)
    console = run_output.console()
    found = None if archive is None else resolve(archive)
    raise typer.Exit(show(found, pid, listen, port, lambda line: console.print(line, soft_wrap=True)))


for command in (archives.runs, archives.show, archives.report, archives.export, archives.replay, archives.recover):
    app.command()(command)
app.command("import")(archives.import_)
app.command()(identify.identify)
app.command()(reproduce.reproduce)
app.command()(init.init)
app.add_typer(calibrate.app, name="calibrate")


def main(arguments: list[str] | None = None) -> None:
    """Entry point."""
    # Imports, runs and reports make many objects and little cyclic garbage: looking for it less often saves a tenth.
    gc.set_threshold(GARBAGE_OBJECTS, 20, 20)
    # A sign that the terminal cannot show (a µ, where it is not UTF-8) must end nothing, a run least of all.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        with printable_streams():
            app(arguments)
    except BrokenPipeError:
        # The reader of our output has gone (`rig runs | head`): that is his decision and no error.
        sys.stderr.close()
        sys.exit(FAULT)
