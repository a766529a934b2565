"""The `rig` command line. Heavy modules are imported inside the commands."""

from __future__ import annotations

import io
import sys
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Annotated

import typer

from rig.cli import archives, calibrate, design, identify, options, reproduce, rigs, study
from rig.cli.exit_status import BAD_INPUT, DONE, FAULT
from rig.cli.expected_errors import PlainErrors, fail
from rig.cli.printable_stream import printable_streams
from rig.cli.run_options import takes_run_options
from rig.experiment.options import RunOptions

if TYPE_CHECKING:
    from rich.console import Console

app = typer.Typer(
    cls=PlainErrors,
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    context_settings={"color": True},  # PrintableStream escapes control sequences instead of click removing them
    rich_markup_mode=None,  # units in square brackets are not markup
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
Host = Annotated[str, typer.Option(metavar="ADDRESS", help="Address of this machine on which to serve the page.")]
Port = Annotated[int, typer.Option(help="Port of the page; where it is taken, or 0, any free one.", min=0, max=65535)]
Live = Annotated[bool, typer.Option("--live", help="Also show the run in the browser.")]


@app.command()
@takes_run_options()
def run(
    ctx: typer.Context,
    protocol: options.ProtocolName,
    *,
    rig: options.RigName = None,
    options: RunOptions,
    live: Live = False,
    host: Host = LOCAL,
    port: Port = LIVE_PORT,
    json: options.AsJson = False,
) -> None:
    """Run a protocol and leave an archive with a report."""
    from rig.experiment import report_process

    _check_live(live, options.fast, host, port)
    begin_report = ctx.with_resource(report_process.prepared(options.fast and options.report))

    from rig.cli import run_output
    from rig.cli.output import console, print_json
    from rig.cli.run_names import report_interrupted
    from rig.cli.terminal import Terminal
    from rig.config.loader import chosen_rig
    from rig.execution.stop_signals import StopSignals
    from rig.experiment import run as experiment
    from rig.experiment.prepare import prepare

    prepared = prepare(protocol, chosen_rig(rig), options)
    screen = console(stderr=json)
    report_interrupted(prepared.folder)
    screen.print(run_output.check_screen(prepared))
    if prepared.plan.trajectory.streams:
        screen.print(run_output.socket_line(), soft_wrap=True)
    if not options.yes and not run_output.confirm(screen):
        fail("not armed", BAD_INPUT)
    with (
        _live_page(host, port, screen) if live else nullcontext(),
        StopSignals() as signals,
        Terminal(screen, lambda: signals.reason, run_output.title(prepared)) as terminal,
    ):
        result = experiment.run(prepared, terminal, begin_report)
    run_output.last_screen(screen, result)
    if json:
        print_json(run_output.result_facts(result))
    raise typer.Exit(run_output.exit_status(result))


def _check_live(live: bool, fast: bool, host: str, port: int) -> None:
    if live and fast:
        fail("--live needs real time: omit --fast", BAD_INPUT)
    if not live and (host, port) != (LOCAL, LIVE_PORT):
        fail("--host and --port need --live", BAD_INPUT)


def _live_page(host: str, port: int, screen: Console) -> AbstractContextManager[None]:
    from rig.live.launch import live_page_of_this_run

    return live_page_of_this_run(host, port, lambda line: screen.print(line, soft_wrap=True))


@app.command()
@takes_run_options("settings")
def check(
    protocol: options.ProtocolName, *, rig: options.RigName = None, options: RunOptions, json: options.AsJson = False
) -> None:
    """Check a protocol against a rig, without touching hardware."""
    from rig.cli import run_output
    from rig.cli.output import console, print_json
    from rig.config.loader import chosen_rig
    from rig.experiment.prepare import prepare

    prepared = prepare(protocol, chosen_rig(rig), options, runs=False)
    if json:
        print_json(run_output.check_facts(prepared))
    else:
        screen = console()
        screen.print(run_output.check_screen(prepared))
        screen.print(run_output.setpoint_plot(prepared.plan, screen.width))
        if prepared.plan.trajectory.tip:
            screen.print(run_output.tip_paths(prepared.plan))
        screen.print(run_output.verdict(prepared), soft_wrap=not screen.is_terminal)


@app.command()
def protocols() -> None:
    """List the named protocols."""
    from protocols import named

    for name, title in named():
        typer.echo(f"{name:22s}{title}")


@app.command()
def vent(rig: options.VentedRig = None, everything: options.Everything = False) -> None:
    """End and vent every running experiment of yours, then vent the rig that is named, whichever process uses it.

    Simulated experiments are ended only where none runs on real devices, or with --all.
    """
    from rig.cli.vent import vent as vent_rigs

    vent_rigs(rig, everything)


@app.command()
@takes_run_options("settings", "model", "parameters", "out")
def simulate(protocol: options.ProtocolName, *, rig: options.RigName = None, options: RunOptions) -> None:
    """Run the model alone, driven by the protocol's set-points; leaves an archive of the same layout."""
    from rig.config.loader import chosen_rig
    from rig.experiment.prepare import prepare
    from rig.experiment.simulate import simulate as run_model

    typer.echo(run_model(prepare(protocol, chosen_rig(rig), options, runs=False)))


@app.command()
def live(
    pid: Annotated[int | None, typer.Option(help="Process of the experiment to watch, if several run.")] = None,
    host: Host = LOCAL,
    port: Port = LIVE_PORT,
) -> None:
    """Show a running experiment in the browser."""
    from rig.cli.output import console
    from rig.live.launch import show

    screen = console()
    raise typer.Exit(show(pid, host, port, lambda line: screen.print(line, soft_wrap=True)))


for command in (archives.note, archives.tag, archives.runs, archives.show, archives.export, archives.recover):
    app.command()(command)
app.command()(archives.report)
app.command()(archives.publish)
app.command()(archives.replay)
app.command("import")(archives.import_)
app.command()(reproduce.reproduce)
app.command()(rigs.workspace)
app.command()(rigs.board)
app.command()(rigs.init)
app.command()(rigs.drivers)
app.command()(rigs.doctor)
app.command("test-driver")(rigs.check_drivers)
app.command()(design.design)
app.command()(study.study)
app.add_typer(identify.app, name="identify")
app.add_typer(calibrate.app, name="calibrate")


def main(arguments: list[str] | None = None) -> None:
    """Entry point."""
    # A character that the terminal cannot encode (a µ, without UTF-8) must not end a run.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        with printable_streams():
            app(arguments)
    except BrokenPipeError:
        # The reader closed the pipe (`rig runs | head`); this is not an error.
        sys.stderr.close()
        sys.exit(FAULT)
