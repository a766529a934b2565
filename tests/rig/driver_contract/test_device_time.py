"""How the durations of calls are judged: the driver is at fault only where a busy machine cannot be."""

from __future__ import annotations

import pytest

from rig.driver_contract.check import BrokenContractError, Check, CheckVerdict, NotJudgedError
from rig.driver_contract.device_time import CallTime, ScanTimes, judge_scans, judged

PERIOD_S = 0.005
CALLS = 200


def calls(took_ms: float, *, slow_ms: float = 0.0, slow: int = 0, processor_ms: float = 0.1) -> list[CallTime]:
    """Calls of a driver, of which every so many is a slow one."""
    times = [CallTime(took_ms * 1e-3, processor_ms * 1e-3)] * CALLS
    for k in range(slow):
        times[k * CALLS // slow] = CallTime(slow_ms * 1e-3, processor_ms * 1e-3)
    return times


def idle(late_ms: float, later_ms: float = 0.0) -> list[float]:
    """How late idle waits end: most of them, and every twentieth."""
    return [(later_ms if later_ms and k % 20 == 0 else late_ms) * 1e-3 for k in range(CALLS)]


QUIET, BUSY = idle(0.08), idle(0.2, 12.0)


@pytest.mark.parametrize("late_s", [QUIET, BUSY])
def test_short_calls_pass_on_any_machine(late_s: list[float]) -> None:
    assert judged("read", calls(0.4), late_s, PERIOD_S).startswith("read 0.40 ms")


def test_calls_as_late_as_idle_waits_are_not_judged() -> None:
    with pytest.raises(NotJudgedError, match=r"machine busy: idle waits end up to 12.00 ms late"):
        judged("read", calls(0.4, slow_ms=30, slow=12), BUSY, PERIOD_S)


def test_the_same_calls_on_a_quiet_machine_are_the_drivers_fault() -> None:
    with pytest.raises(BrokenContractError, match="12 of 200 calls of read take longer"):
        judged("read", calls(0.4, slow_ms=30, slow=12), QUIET, PERIOD_S)


def test_calls_that_always_take_too_long_are_the_drivers_fault_on_a_busy_machine_too() -> None:
    with pytest.raises(BrokenContractError, match="the control period is 5 ms"):
        judged("write", calls(30.0), BUSY, PERIOD_S)


def test_calls_longer_than_a_busy_machine_explains_are_the_drivers_fault() -> None:
    with pytest.raises(BrokenContractError, match="12 of 200"):
        judged("read", calls(0.4, slow_ms=200, slow=12), BUSY, PERIOD_S)


def test_calls_that_compute_too_long_are_the_drivers_fault_on_a_busy_machine_too() -> None:
    with pytest.raises(BrokenContractError):
        judged("read", calls(8.0, processor_ms=8.0), idle(30.0), PERIOD_S)


def test_a_check_that_cannot_decide_is_neither_passed_nor_failed() -> None:
    check = Check("durations", "", lambda late_s: judged("read", calls(9.0), late_s, PERIOD_S))
    found = check.result("card daq", idle(20.0))
    assert (found.verdict, found.failed) == (CheckVerdict.NOT_JUDGED, False)
    assert found.found.startswith("machine busy")


LEAST_HZ, STALE_S = 100.0, 0.1


def scans(number: int, late_s: list[float], age_s: float = 0.002) -> ScanTimes:
    """Scans of one second."""
    return ScanTimes(number, 0.98, age_s, 1.0, late_s)


@pytest.mark.parametrize("late_s", [QUIET, BUSY])
def test_scans_that_come_often_pass_on_any_machine(late_s: list[float]) -> None:
    judge_scans(scans(180, late_s), LEAST_HZ, STALE_S)


@pytest.mark.parametrize(
    ("found", "message"),
    [
        (scans(60, QUIET), "60 scans/s; control runs at 200 Hz"),
        (scans(0, BUSY), "0 scans in 1 s"),
        (scans(180, QUIET, 0.15), "150 ms old at best"),
        (scans(15, idle(1.0)), "14 scans/s; control"),
        (scans(180, BUSY, 0.3), "300 ms old at best"),
    ],
)
def test_rare_or_old_scans_beyond_what_the_machine_explains_are_the_drivers_fault(
    found: ScanTimes, message: str
) -> None:
    with pytest.raises(BrokenContractError, match=message):
        judge_scans(found, LEAST_HZ, STALE_S)


@pytest.mark.parametrize("found", [scans(60, BUSY), scans(180, idle(15.0), 0.15)])
def test_rare_or_old_scans_that_a_busy_machine_explains_are_not_judged(found: ScanTimes) -> None:
    with pytest.raises(NotJudgedError, match="machine busy: idle waits end up to"):
        judge_scans(found, LEAST_HZ, STALE_S)
