"""A run states whether the pressures confirm the safe state, whichever process has written it."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

import runs
from rig.hardware.vent_verification import UNCONFIRMED
from rig.simulator.faults import ValveFault
from runs.records import Status
from runs.run import Run
from scripts.faults.catalogue import FOR_EVER
from scripts.faults.injections import KILL
from scripts.faults.trial_run import CONTROL, OBSERVER, SUPERVISOR, TrialRun

pytestmark = pytest.mark.realtime

CONFIRMED = "the valves are in their safe state; the pressures "
"""They confirm it, or are low: where another process reads them later, it may not have seen them fall."""
DEAD_INPUTS = {"failing_reads": FOR_EVER}
"""What a hung bus looks like to a program: writes are accepted, and no reading comes."""
STUCK_OPEN = {"valve_1": ValveFault.STUCK, "valve_value_1": 8.0}
SLOW_TUBE = "tube_l_s_bar: 0.03"


@pytest.fixture
def struck(tmp_path: Path) -> Callable[..., tuple[TrialRun, list[str]]]:
    """Strike a run that moves its valves; return it after its end, with the messages of its archive."""

    def strike(
        *killed: str, after_s: float = 0.0, edit: Callable[[str], str] = str, **fault: float
    ) -> tuple[TrialRun, list[str]]:
        run = TrialRun(tmp_path, edit=edit)
        try:
            registers = run.wait_until_moving()
            time.sleep(after_s)
            if fault:
                registers.faults.inject(**fault)
            run.signal(killed, KILL)
            run.watch(registers)
            registers.close()
            run.process.wait(20)
        finally:
            run.close()
        return run, [event.message for event in archive(run).events]

    return strike


def archive(run: TrialRun) -> Run:
    return runs.open(next(run.out.glob("*.h5")))


def test_pressures_confirm_what_the_watchdog_has_written(struck: Callable[..., tuple[TrialRun, list[str]]]) -> None:
    run, messages = struck(CONTROL)
    assert messages[-1].startswith(CONFIRMED)
    assert UNCONFIRMED not in run.output


@pytest.mark.parametrize("killed", [(), (CONTROL,)], ids=["by control", "by the supervisor"])
@pytest.mark.parametrize(
    ("fault", "reason"),
    [(DEAD_INPUTS, "the pressures cannot be read"), (STUCK_OPEN, "actuator 1 at 1.50 bar")],
    ids=["dead inputs", "stuck valve"],
)
def test_a_safe_state_that_no_pressure_shows_is_stated_as_unconfirmed(
    struck: Callable[..., tuple[TrialRun, list[str]]], killed: tuple[str, ...], fault: dict[str, float], reason: str
) -> None:
    run, messages = struck(*killed, **fault)
    assert run.process.returncode == 1
    assert archive(run).status is Status.ABORTED
    assert UNCONFIRMED in archive(run).message
    assert reason in archive(run).message
    assert not any("the valves are in their safe state" in message for message in messages)
    assert UNCONFIRMED in run.output


def test_the_last_process_states_it_on_the_terminal(tmp_path: Path) -> None:
    run = TrialRun(tmp_path)
    try:
        registers = run.wait_until_moving()
        registers.faults.inject(**DEAD_INPUTS)
        run.signal((SUPERVISOR, CONTROL, OBSERVER), KILL)
        run.watch(registers)
        registers.close()
        assert UNCONFIRMED in run.output
    finally:
        run.close()


def test_a_bench_that_vents_slowly_raises_no_alarm(struck: Callable[..., tuple[TrialRun, list[str]]]) -> None:
    """Its chambers take longer than the first wait to empty."""

    def slow(text: str) -> str:
        assert "chamber: {" in text
        return text.replace("chamber: {", f"chamber: {{{SLOW_TUBE}, ")

    run, messages = struck(CONTROL, edit=slow, after_s=1.0)
    assert messages[-1].startswith("the valves are in their safe state; the pressures confirm it: ")
    assert UNCONFIRMED not in run.output
