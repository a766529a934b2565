"""`rig vent`: ends and vents the running experiments, then the rig that is named.

Nothing that is read from a file of the user comes before the first write, and nothing that cannot be read or vented
keeps the rest from being vented.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass

import typer
from pydantic import ValidationError

from rig.cli.exit_status import BAD_INPUT, FAULT
from rig.config.bench import BenchConfig, VentedBench
from rig.config.drivers import Reality
from rig.hardware.lock import described, locked_devices, outputs_of, runs_of
from rig.hardware.running import RunningRig, UnreadableRecord, signal_run, signalled
from rig.hardware.vent import Venting, VentResult, results

NOTHING = "nothing to vent: --rig, SOFTRIG_RIG or softrig.yaml here names no rig, and no experiment of this user runs"


@dataclass(frozen=True)
class _Rig:
    """A rig whose venting has begun, and where it is known from."""

    bench: BenchConfig
    source: str
    venting: Venting
    run: RunningRig | None = None


def vent(option: str | None, everything: bool = False) -> None:
    """Vent the running experiments of this user and the named rig.

    With `everything` also simulated experiments beside those on real devices.

    Raises:
        typer.Exit: status 1, a rig could not be read or vented, the others are vented; 2, there is nothing to vent.
    """
    rigs, problems = _running(everything)
    nothing = ""
    try:
        named, unread, nothing = _named(option, rigs)
        rigs += named
        problems += unread
    except Exception as error:  # no file of the user may keep a running experiment from being vented
        problems.append(f"the rig that is named cannot be read: {error}")
    for rig, result in zip(rigs, results(rig.venting for rig in rigs), strict=True):
        if result.failures:
            problems += [f"rig {rig.bench.name} ({rig.source}): {failure}" for failure in result.failures]
        else:
            typer.echo(f"{_vented(rig.bench, result)}; {rig.source}")
            _forget(rig)
    for problem in problems:
        typer.echo(problem, err=True)
    if problems:
        raise typer.Exit(FAULT)
    if nothing:
        typer.echo(nothing, err=True)
    if not rigs:
        for node, pid in locked_devices():
            typer.echo(f"{node} is held by {described(pid)}: name its rig with --rig", err=True)
        raise typer.Exit(BAD_INPUT)


def _running(everything: bool) -> tuple[list[_Rig], list[str]]:
    """The running experiments, whose venting begins, and what cannot be read of them."""
    told = signalled(simulated=everything)
    rigs, problems = _begun_runs(told.runs)
    problems += [_unread(record, f"record {record.file}", record.reason) for record in told.unreadable]
    return rigs, problems


def _begun_runs(runs: Iterable[RunningRig]) -> tuple[list[_Rig], list[str]]:
    rigs, problems = [], []
    for run in runs:
        try:
            bench = VentedBench.model_validate(run.bench)
        except ValidationError as error:
            reason = str(error).replace("\n", " ")
            problems.append(_unread(run, f"{run.purpose} on rig {run.rig}", reason))
        else:
            rigs.append(_begun(bench, _described(run), run))
    return rigs, problems


def _unread(record: RunningRig | UnreadableRecord, what: str, reason: str) -> str:
    told = f"NOT vented: {what} of process {record.process.pid} cannot be read ({reason})"
    if record.alive:
        return f"{told}; the process was told to end. Look at the gauge, and vent its rig with --rig"
    # Nobody but the operator can tell whether its valves are safe, so it is listed until the operator says so.
    return (
        f"{told}; the process has ended. Look at the gauge, vent its rig with --rig, and then remove {record.file}, "
        "or rig vent lists it again"
    )


def _described(run: RunningRig) -> str:
    ended = "" if run.process.alive else ", which has ended"
    return f"it was held by process {run.process.pid}, {run.purpose}{ended}"


def _forget(rig: _Rig) -> None:
    """Remove what a killed run has left, once it is vented: its record, and its simulated cards."""
    if rig.run is not None and not rig.run.alive:
        with suppress(OSError):
            rig.run.file.unlink(missing_ok=True)
            if rig.run.simulated:
                from rig.simulator.plant_launcher import remove_cards

                remove_cards(rig.run)


def _begun(bench: BenchConfig, source: str, run: RunningRig | None = None) -> _Rig:
    venting = Venting(bench, of_run=run is not None)
    venting.begin()
    return _Rig(bench, source, venting, run)


def _named(option: str | None, running: list[_Rig]) -> tuple[list[_Rig], list[str], str]:
    """The named rig, whose venting begins, what cannot be read of it, and what there is not to vent."""
    # Imported here: the running experiments do not wait for it.
    from protocols import BadInputError
    from rig.config import vented_bench
    from rig.config.loader import path_of, unread_named_rig
    from rig.simulator.plant_launcher import is_absent

    choice = unread_named_rig(option)
    if choice is None:
        return [], [], "" if running else NOTHING
    source = f"rig chosen by {choice.source}"
    try:
        bench, unread = vented_bench.read(path_of(choice.name))
    except BadInputError as bad:
        return [], [f"NOT vented: {problem} ({source})" for problem in bad.problems], ""
    problems = [f"NOT vented: {problem} ({source})" for problem in unread]
    if bench is None:
        return [], problems, ""
    if outputs_of(bench) <= {output for rig in running for output in outputs_of(rig.bench)}:
        return [], problems, ""
    # Each run of a simulated rig has cards of its own.
    own = runs_of(bench)
    told = {rig.run.file for rig in running if rig.run is not None}
    others = [run for run in own if run.file not in told]
    for run in others:
        signal_run(run)
    rigs, unreadable = _begun_runs(others)
    problems += unreadable
    if not is_absent(bench):
        return [*rigs, _begun(bench, source)], problems, ""
    nothing = f"nothing to vent: the simulated rig {bench.name}, chosen by {choice.source}, does not run"
    return rigs, problems, "" if own else nothing


def _vented(bench: BenchConfig, vented: VentResult) -> str:
    if vented.gone:
        return f"rig {bench.name} is simulated, and its cards do not exist: its run has ended, or had not made them"
    confirmation = f"; {vented.confirmation}" if vented.confirmation else ""
    if vented.unverified:
        gauge = confirmation or ": look at the gauge"
        cards = f"card {', '.join(vented.unverified)} has no read-back"
        return f"every output of rig {bench.name} was commanded to vent; {cards}{gauge}"
    mock = all(card.reality is not Reality.REAL for card in bench.cards.values())
    simulated = " (simulated: no hardware was touched)" if mock else ""
    return f"every chamber of rig {bench.name} is open to the exhaust{simulated}{confirmation}"
