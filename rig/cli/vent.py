"""`rig vent`: vent a named rig, or the rigs of running experiments."""

from __future__ import annotations

import typer

from rig.cli.exit_status import BAD_INPUT
from rig.config.loader import load, named_rig
from rig.config.schema import RigConfig
from rig.hardware.cards.base import CardError
from rig.hardware.lock import described, locked_devices, running_rigs
from rig.hardware.vent import VentResult
from rig.hardware.vent import vent as vent_rig
from rig.simulator.plant_launcher import is_absent

NOTHING = "nothing to vent: --rig, SOFTRIG_RIG or softrig.yaml here names no rig, and no experiment of this user runs"


def vent(option: str | None) -> None:
    """Vent the named rig, or else every rig of this user's running experiments.

    Raises:
        BadInputError: the named rig is invalid.
        CardError: a rig cannot be vented or does not stay vented; the other rigs are vented.
        typer.Exit: status 2, there is nothing to vent.
    """
    if (chosen := named_rig(option)) is not None:
        config = load(chosen.name)
        if is_absent(config):
            simulated = f"the simulated rig {config.name}, chosen by {chosen.source}, has never run"
            typer.echo(f"nothing to vent: {simulated}", err=True)
            raise typer.Exit(BAD_INPUT)
        typer.echo(f"{_vented(config, vent_rig(config))}; rig chosen by {chosen.source}")
        return
    running = running_rigs()
    if not running:
        typer.echo(NOTHING, err=True)
        for node, pid in locked_devices():
            typer.echo(f"{node} is held by {described(pid)}: name its rig with --rig", err=True)
        raise typer.Exit(BAD_INPUT)
    failures = []
    for held in running:
        try:
            vented = vent_rig(held.config)
        except CardError as error:
            failures.append(f"rig {held.config.name}: {error}")
        else:
            typer.echo(f"{_vented(held.config, vented)}; it was held by process {held.pid}, {held.purpose}")
    if failures:
        raise CardError("; ".join(failures))


def _vented(config: RigConfig, vented: VentResult) -> str:
    confirmation = f"; {vented.confirmation}" if vented.confirmation else ""
    if vented.unverified:
        gauge = confirmation or ": look at the gauge"
        cards = f"card {', '.join(vented.unverified)} has no read-back"
        return f"every output of rig {config.name} was commanded to vent; {cards}{gauge}"
    mock = all(card.simulated for card in config.cards.values())
    simulated = " (simulated: no hardware was touched)" if mock else ""
    return f"every chamber of rig {config.name} is open to the exhaust{simulated}{confirmation}"
