"""The outcome of a run: what ended it comes first, a failure of its end aborts it, nothing is stated twice."""

from __future__ import annotations

import pytest

from rig.hardware.safe_state import UNSAFE
from rig.hardware.vent_verification import UNCONFIRMED, VentOutcome
from rig.realtime.outcome import Ending, EndOfRun, outcome
from runs.records import Level, Status

FINISHED = Ending(Status.FINISHED)
STOPPED = Ending(Status.INTERRUPTED, "stopped by anna")
EMPTY, FULL = VentOutcome(True, "0.00 bar"), VentOutcome(False, f"{UNCONFIRMED}: 0.50 bar")


@pytest.mark.parametrize(
    ("ending", "end", "told", "reported"),
    [
        (FINISHED, EndOfRun(lambda: EMPTY), FINISHED, [(Level.INFO, "control")]),
        (STOPPED, EndOfRun(lambda: EMPTY), STOPPED, [(Level.INFO, "control")]),
        (FINISHED, EndOfRun(lambda: FULL), Ending(Status.ABORTED, FULL.sentence), [(Level.FAULT, "control")]),
        (
            STOPPED,
            EndOfRun(lambda: EMPTY, (("watchdog", "control hung"),), writer="watchdog"),
            Ending(Status.ABORTED, "stopped by anna; control hung"),
            [(Level.FAULT, "watchdog"), (Level.INFO, "watchdog")],
        ),
        (
            Ending(Status.ABORTED, "control hung"),
            EndOfRun(lambda: EMPTY, (("watchdog", "control hung"),), writer="watchdog"),
            Ending(Status.ABORTED, "control hung"),
            [(Level.INFO, "watchdog")],
        ),
    ],
)
def test_a_failure_of_the_end_aborts_the_run_and_is_stated_once(
    ending: Ending, end: EndOfRun, told: Ending, reported: list[tuple[Level, str]]
) -> None:
    events: list[tuple[Level, str]] = []
    assert outcome(ending, end, lambda level, source, _: events.append((level, source))) == told
    assert events == reported


@pytest.mark.parametrize(
    ("ending", "end"),
    [
        (FINISHED, EndOfRun(lambda: pytest.fail("not watched"), unsafe=f"{UNSAFE}: card daq: gone")),
        (Ending(Status.ABORTED, FULL.sentence), EndOfRun(lambda: pytest.fail("not watched"))),
    ],
    ids=["unsafe", "known not to vent"],
)
def test_chambers_are_not_watched_where_the_valves_are_known_not_to_be_safe(ending: Ending, end: EndOfRun) -> None:
    assert outcome(ending, end, lambda *_: None) == Ending(Status.ABORTED, ending.message or end.unsafe)


def test_a_card_that_no_process_can_write_is_stated_once_though_each_puts_it_otherwise() -> None:
    ending = Ending(Status.ABORTED, f"{UNSAFE}: card daq: gone")
    end = EndOfRun(lambda: EMPTY, unsafe=f"{UNSAFE}: neither control nor the watchdog acts")
    assert outcome(ending, end, lambda *_: None) == ending
