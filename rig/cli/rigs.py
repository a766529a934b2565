"""Commands about a rig and its drivers."""

from __future__ import annotations

import re
import sys
import textwrap
from pathlib import Path
from typing import Annotated

import typer

from rig.cli import completion
from rig.cli.completion import DATA
from rig.cli.exit_status import BAD_INPUT, DONE, FAULT, INTERRUPTED
from rig.cli.options import AsJson, BoardFile, DrawingFile, ExistingRig, Folder, OutputFile, Replace, RigName, Variant

EXPLAINED = {
    "name": "The rig's name. It appears in reports, file names and archives. Letters, digits, '-' and '_'.",
    "description": "One line for people.",
    "calibrations": "Files that `rig calibrate` has written. They replace what is stated below.",
    "metadata": "Facts for the archive: `values` by name (specimen, batch, fibre_angle_deg, ..), and the names that "
    "`required` makes every run give, here or with `rig run --meta NAME=VALUE`.",
    "cards": "Data-acquisition cards. The name before the braces is yours; valves and sensors refer to "
    "it. `outputs` and `inputs` are the channels that the card has.",
    "valves": "One valve for each actuator; a valve may drive several. `type: flow` meters flow and needs "
    "the program's pressure regulator; `type: pressure` is a regulator that takes a set-point "
    "voltage. `closed_V` is where all ports are shut (5 V by default). `safe_state` says what "
    "happens when a run ends: vent (default) or hold.",
    "sensors": "One pressure sensor for each actuator. Gauge pressure is linear in voltage from `span_V` "
    "to `span_bar`; both are 0 to 10 by default.",
    "inputs": "Optional: quantities that are recorded beside the pressures, such as force or temperature. Each is "
    "linear in voltage, from `span_V` to `span` in its `unit`. One with a `tip_force_direction` "
    "measures the load of the tip, which the model then takes.",
    "emergency_stops": "Optional: normally-closed contacts at digital inputs. One that opens, or whose wire breaks, "
    "ends the run and vents every chamber.",
    "limits": "Limits of set-points and samples. A run that violates one ends, and the "
    "valves go to their safe state. `pressure_bar` is the highest pressure that the arm may "
    "see: set it before the first run.",
    "control": "The pressure regulator: its rate, the closed loop's bandwidth, the integration time, and "
    "the volume of one chamber with its tube.",
    "trackers": "Optional, in place of cameras: a device that gives the pose of the tip itself.",
    "cameras": "Optional: cameras that see the board at the arm's tip. `lens` comes from `rig calibrate camera`. "
    "`placement` is the camera (x right, y down, z forward) in the rod-base frame, "
    "`rotation_deg` a rotation vector.",
    "board": "The checkerboard on the end cap: its squares, not its inner corners. `placement` is its "
    "centre in the tip frame; `rig calibrate tool` finds it.",
    "sections": "Optional: boards with markers along the arm, each with the arc length `at_mm` of its section. "
    "Their poses are measured, archived and drawn.",
    "arm": "The manipulator: geometry as built, material from `rig identify`, mass of the end cap.",
    "uncertainties": "Standard uncertainties of what is stated above, in the unit of each name, for `rig identify`.",
    "model": "The model that runs beside the rig, and whether it is static or dynamic.",
    "tip_control": "How the tip follows the reference of `tip` steps: the controller, the delay from a frame to its "
    "plan, and the lag of the pressures.",
    "recording": "Which pictures are stored, and their encoding.",
    "simulator": "The plant behind the mock devices: the true valves, chambers, sensors and material. Its "
    "numbers intentionally differ from the model's. A rig without a mock device has no such "
    "section.",
}
"""Comment of each section of a rig file; `commented` adds the drivers of devices."""

SUPPLY = (
    "The test moves every output of the rig's real cards. Shut the air off and vent the line, "
    "or take the supply from the valves."
)

_HEAD = """\
# The rig: what this bench consists of. Every key has its unit in its name; docs/reference/rig-file.md explains each.
# `rig` commands in this folder use this file, unless --rig or the variable SOFTRIG_RIG names another.
# Change it, then run: rig check ramp-a
"""
_WIDTH = 110
_SECTION = re.compile(r"([a-z_]+):")


def commented(text: str) -> str:
    """Return a rig's YAML with a comment for every section, without its leading comments."""
    from rig.config.card_sections import CARD_DRIVERS
    from rig.config.sections import CAMERA_DRIVERS
    from rig.config.tracker_sections import TRACKER_DRIVERS

    explained = dict(EXPLAINED)
    for registry in (CARD_DRIVERS, CAMERA_DRIVERS, TRACKER_DRIVERS):
        names = ", ".join(registry.built_in)
        explained[registry.kind] += f" Drivers: {names}; `rig drivers` explains them and those of plug-ins."
    lines = text.splitlines()
    while lines and (lines[0].startswith("#") or not lines[0]):
        lines.pop(0)
    out = [_HEAD]
    for line in lines:
        if (section := _SECTION.match(line)) and section[1] in explained:
            if not out[-1].startswith("#") and section[1] != "description":
                out.append("")
            out += [f"# {part}" for part in textwrap.wrap(explained[section[1]], _WIDTH)]
        out.append(line)
    return re.sub(r"\n{3,}", "\n\n", "\n".join(out)) + "\n"


def init(
    like: Annotated[
        str, typer.Option(metavar="NAME", help="Bundled rig to start from.", autocompletion=completion.rigs)
    ] = "mock",
    to: OutputFile = Path("softrig.yaml"),
    replace: Replace = False,
) -> None:
    """Write a commented rig file to start from."""
    from rig.config.loader import HERE, VARIABLE, path_of
    from runs.overwriting import refuse_existing, write_text

    refuse_existing([to], replace=replace)
    write_text(to, commented(path_of(like).read_text(encoding="utf-8")))
    typer.echo(to)
    if to == HERE:
        typer.echo(f"every later rig command in this folder uses it, unless --rig or {VARIABLE} names another rig")
    else:
        typer.echo(f"a command uses it with --rig {to}")


def board(rig: RigName = None, to: BoardFile = None, replace: Replace = False) -> None:
    """Write the board of a rig to scale, with a ruler, to print and measure."""
    from protocols.problems import bad_input
    from rig.calibrate import board_drawing
    from rig.config.loader import chosen_rig, load, path_of
    from runs.overwriting import refuse_existing

    chosen = chosen_rig(rig).name
    config = load(chosen)
    if config.board is None:
        raise bad_input(str(path_of(chosen)), "no `board`", "a rig with a board")
    file = to or Path(f"board-{config.name}.pdf")
    if file.suffix.lower() not in board_drawing.FORMATS:
        raise bad_input("--to", str(file), f"a file whose name ends with {' or '.join(board_drawing.FORMATS)}")
    refuse_existing([file], replace=replace)
    page = board_drawing.write(config.board, config.name, file)
    for line in board_drawing.texts(config.board, page, config.name):
        typer.echo(line)
    typer.echo(file)


def workspace(
    rig: RigName = None, model: Variant = None, to: DrawingFile = None, replace: Replace = False, json: AsJson = False
) -> None:
    """Show what the tip of a rig can reach at rest; --to FILE.png, .pdf or .svg draws it."""
    from rig.cli import rig_output
    from rig.cli.output import console, print_json
    from rig.config.loader import chosen_rig, load
    from rig.config.sections import variant_named
    from rig.tip_planning.workspace import workspace as sampled

    if to is not None:
        rig_output.check_drawing(to, replace)
    config = load(chosen_rig(rig).name)
    space = sampled(config, variant_named(model))
    if to is not None:
        rig_output.save_drawing(space, to)
    if json:
        print_json(rig_output.workspace_facts(space, config))
        return
    console().print(rig_output.workspace_table(space, config))
    if to is not None:
        console().print(f"drawing  {to}", soft_wrap=True)


def doctor(
    rig: ExistingRig = None,
    out: Folder = DATA,
    json: AsJson = False,
) -> None:
    """Check this machine, and the cards of a rig; name a remedy for each missing part."""
    from rig.cli import rig_output
    from rig.cli.output import console, print_json
    from rig.config.loader import load, named_rig
    from rig.doctor import examine

    chosen = named_rig(rig)
    findings = examine(out, load(chosen.name) if chosen else None)
    if json:
        print_json(findings)
    else:
        console().print(rig_output.findings_table(findings))
    raise typer.Exit(FAULT if any(f.verdict == "missing" for f in findings) else DONE)


def drivers(json: AsJson = False) -> None:
    """List what a rig file can name: drivers, valves, boards, effects and controllers, with their packages.

    Status 1: an installed plug-in cannot be used.
    """
    from rig.cli import rig_output
    from rig.cli.output import console, print_json
    from rig.hardware.installed_drivers import installed_drivers

    rows = tuple(installed_drivers())
    if json:
        print_json(rows)
    else:
        console().print(rig_output.drivers_table(rows))
    raise typer.Exit(FAULT if any(row.fault for row in rows) else DONE)


def check_drivers(
    rig: Annotated[
        str,
        typer.Argument(
            metavar="NAME|FILE", help="Rig whose cards, cameras and trackers to test.", autocompletion=completion.rigs
        ),
    ],
    supply_off: Annotated[
        bool, typer.Option("--supply-off", help="The valves have no supply: do not ask whether they have.")
    ] = False,
    json: AsJson = False,
) -> None:
    """Test the drivers of a rig against what softrig relies on; moves the outputs of its cards."""
    from rig.cli import rig_output
    from rig.cli.output import console, print_json
    from rig.config import loader
    from rig.conformance.runner import results
    from rig.execution.stop_signals import StopSignals

    rig_file = loader.path_of(rig)
    config = loader.load(rig_file)
    real = [name for name, card in config.cards.items() if not card.driven_by.simulated]
    if real and not supply_off:
        typer.echo(SUPPLY, err=True)
        if not sys.stdin.isatty():
            typer.echo(f"card {', '.join(real)} is real: confirm with --supply-off", err=True)
            raise typer.Exit(BAD_INPUT)
        if not typer.confirm("Is the supply of the valves off?", default=False, err=True):
            raise typer.Exit(BAD_INPUT)
    screen = console(stderr=True)
    found = []
    with StopSignals() as signals:
        for result in results(config, rig_file, stop=lambda: signals.reason is not None):
            found.append(result)
            screen.print(rig_output.result_line(result), soft_wrap=True)
    if json:
        print_json(found)
    else:
        console().print(rig_output.results_table(found))
    if signals.reason is not None:
        raise typer.Exit(INTERRUPTED)
    raise typer.Exit(FAULT if any(result.failed for result in found) else DONE)
