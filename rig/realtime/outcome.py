"""How a run ends: its status and message, from what ended it and from what its end has shown.

Both executors decide by `outcome`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from rig.hardware.safe_state import UNSAFE
from rig.hardware.vent_verification import UNCONFIRMED, VentOutcome
from runs.records import Level, Status


class Ending(NamedTuple):
    """The status of a run and what is said of it."""

    status: Status
    message: str = ""

    def aborted(self, failure: str) -> Ending:
        """This ending with a failure, which is stated after what is already said; the same without one."""
        if not failure:
            return self
        said = self.message if failure in self.message else "; ".join(filter(None, (self.message, failure)))
        return Ending(Status.ABORTED, said)


@dataclass(frozen=True)
class EndOfRun:
    """What is known once the safe state of a run is written, or could not be.

    `vented` watches the chambers vent; it is not called where the valves are known not to be safe.
    """

    vented: Callable[[], VentOutcome]
    failures: tuple[tuple[str, str], ...] = ()
    """Source and message of the processes that have failed."""
    unsafe: str = ""
    """Why the safe state could not be written; empty if it was."""
    writer: str = "control"
    """The process that has written it."""


def outcome(ending: Ending, end: EndOfRun, report: Callable[[Level, str, str], None]) -> Ending:
    """The outcome of a run that `ending` has ended; every failure of its end aborts it.

    `report` takes what `ending` does not say: each failure, and that the valves are safe.
    """
    for source, failure in (*end.failures, (end.writer, end.unsafe)):
        if failure not in ending.message:
            report(Level.FAULT, source, failure)
        # An unplugged card is stated once, not by each process that has tried to write to it.
        stated = UNSAFE in ending.message and UNSAFE in failure
        ending = ending.aborted(ending.message if stated else failure)
    if end.unsafe or UNCONFIRMED in ending.message:
        return ending
    vented = end.vented()
    if vented.confirmed:
        report(Level.INFO, end.writer, f"the valves are in their safe state; {vented.sentence}")
        return ending
    report(Level.FAULT, end.writer, vented.sentence)
    return ending.aborted(vented.sentence)
