"""The monitor of the tip controller: a loss counts where a tip path needs the controller."""

from __future__ import annotations

import numpy as np
import pytest

from rig.control.plan_follower import SetPointSource
from rig.tip_control.monitor import TipControlMonitor
from runs.records import Level, SolveStatus
from runs.tip_plans import PlanCounts

DIED = "the tip controller process died (exit status -9)"


def test_a_controller_that_is_lost_in_a_tip_path_is_the_message_of_the_run() -> None:
    monitor = TipControlMonitor()
    assert not list(monitor.events(0, 1.0, SetPointSource.PLAN, ""))
    (lost,) = monitor.events(1, 2.0, SetPointSource.PLAN, DIED)
    assert lost.message == f"{DIED}; the run continues without it"
    assert not monitor.message(PlanCounts())
    list(monitor.events(2, 2.3, SetPointSource.LOST, DIED))
    assert monitor.message(PlanCounts()) == f"the tip lost its controller at 2.30 s of the protocol: {DIED}"


def test_a_controller_that_is_lost_after_the_last_tip_path_is_recorded_and_does_not_fail_the_run() -> None:
    monitor = TipControlMonitor()
    list(monitor.events(0, 1.0, SetPointSource.PLAN, ""))
    (lost,) = monitor.events(1, 5.0, SetPointSource.PROTOCOL, DIED)
    assert DIED in lost.message
    assert not list(monitor.events(2, 9.0, SetPointSource.PROTOCOL, DIED))
    assert not monitor.message(PlanCounts())


def test_a_controller_without_plans_is_the_message_of_the_run() -> None:
    monitor = TipControlMonitor()
    list(monitor.events(0, 1.0, SetPointSource.LOST, ""))
    assert not monitor.message(PlanCounts())
    list(monitor.events(0, 1.8, SetPointSource.LOST, ""))
    assert "no plan that could be followed for 1 s" in monitor.message(PlanCounts())


def test_a_controller_that_stops_was_lost_when_its_last_plan_ended() -> None:
    monitor = TipControlMonitor()
    list(monitor.events(0, 1.0, SetPointSource.PLAN, ""))
    list(monitor.events(1, 2.3, SetPointSource.LOST, ""))
    list(monitor.events(2, 3.0, SetPointSource.LOST, "", responds=False))
    reason = "its process does not respond: no plan for 1 s"
    assert monitor.message(PlanCounts()) == f"the tip lost its controller at 2.30 s of the protocol: {reason}"


def test_a_stall_is_a_warning_and_does_not_fail_the_run() -> None:
    monitor = TipControlMonitor()
    list(monitor.events(0, 1.0, SetPointSource.PLAN, ""))
    (lost,) = monitor.events(1, 2.3, SetPointSource.LOST, "")
    assert lost.level is Level.WARNING
    assert "without feedback" in lost.message
    (again,) = monitor.events(2, 2.6, SetPointSource.PLAN, "")
    assert "plans are followed again, after 0.30 s" in again.message
    assert not monitor.message(PlanCounts())


def counted(*statuses: SolveStatus) -> PlanCounts:
    counts = PlanCounts()
    counts.add(np.array(statuses))
    return counts


def test_the_message_of_a_run_states_how_many_plans_were_refused_and_why() -> None:
    counts = counted(*[SolveStatus.OUT_OF_LIMITS] * 3, SolveStatus.LATE, *[SolveStatus.SOLVED] * 6)
    refused = "4 of 10 plans of the tip controller were refused: 3 out of limits, 1 late"
    assert TipControlMonitor().message(counts) == refused
    lost = TipControlMonitor()
    list(lost.events(0, 1.0, SetPointSource.LOST, ""))
    list(lost.events(1, 2.0, SetPointSource.LOST, ""))
    assert lost.message(counts).startswith("the tip lost its controller at 1.00 s of the protocol: ")
    assert lost.message(counts).endswith(f"; {refused}")


@pytest.mark.parametrize("reason", [SolveStatus.LATE, SolveStatus.NO_PATH, SolveStatus.NOT_SOLVED])
def test_a_plan_that_is_refused_because_time_has_passed_does_not_fail_the_run(reason: SolveStatus) -> None:
    assert TipControlMonitor().message(counted(reason, SolveStatus.SOLVED)) == ""
