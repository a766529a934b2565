"""Commands about drivers: `rig drivers` and `rig test-driver`."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from rig.cli import completion
from rig.cli.exit_status import BAD_INPUT, DONE, FAULT
from rig.cli.options import AsJson

SUPPLY = (
    "The test moves every output of the rig's real cards. Shut the air off and vent the line, "
    "or take the supply from the valves."
)


def drivers(json: AsJson = False) -> None:
    """List the drivers of cards, cameras and trackers and the valve types, with their packages.

    Status 1: an installed plug-in cannot be used.
    """
    from rig.cli import driver_output
    from rig.cli.output import console, print_json
    from rig.hardware.installed_drivers import installed_drivers

    rows = tuple(installed_drivers())
    if json:
        print_json(rows)
    else:
        console().print(driver_output.table(rows))
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
    unplug: Annotated[bool, typer.Option("--unplug", help="Also test a pulled cable; asks you to pull it.")] = False,
    json: AsJson = False,
) -> None:
    """Test the drivers of a rig against what softrig relies on; moves the outputs of its cards."""
    from rig.cli import driver_output
    from rig.cli.output import console, print_json
    from rig.config import loader
    from rig.driver_contract.runner import results

    rig_file = loader.path_of(rig)
    config = loader.load(rig_file)
    real = [name for name, card in config.cards.items() if not card.simulated]
    if real and not supply_off:
        typer.echo(SUPPLY, err=True)
        if not sys.stdin.isatty():
            typer.echo(f"card {', '.join(real)} is real: confirm with --supply-off", err=True)
            raise typer.Exit(BAD_INPUT)
        if not typer.confirm("Is the supply of the valves off?", default=False, err=True):
            raise typer.Exit(BAD_INPUT)
    screen = console(stderr=True)
    found = []
    for result in results(config, rig_file, _pulled if unplug else None):
        found.append(result)
        screen.print(driver_output.result_line(result), soft_wrap=True)
    if json:
        print_json(found)
    else:
        console().print(driver_output.results_table(found))
    raise typer.Exit(FAULT if any(result.failed for result in found) else DONE)


def _pulled(card: str) -> None:
    typer.prompt(f"Pull the cable of card {card}; then Enter", default="", show_default=False, err=True)
