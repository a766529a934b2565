"""The monitor of the tip controller: a loss counts where a tip path needs the controller."""

from __future__ import annotations

from rig.tip_control.monitor import TipControlMonitor
from rig.tip_control.plan_follower import SetPointSource

DIED = "the tip controller process died (exit status -9)"


def test_a_controller_that_is_lost_in_a_tip_path_is_the_message_of_the_run() -> None:
    monitor = TipControlMonitor()
    assert not list(monitor.events(0, 1.0, SetPointSource.PLAN, ""))
    (lost,) = monitor.events(1, 2.0, SetPointSource.PLAN, DIED)
    assert lost.message == f"{DIED}; the run continues without it"
    assert not monitor.message
    list(monitor.events(2, 2.3, SetPointSource.HELD, DIED))
    list(monitor.events(3, 3.0, SetPointSource.LOST, DIED))
    assert monitor.message == f"the tip lost its controller at 2.30 s of the protocol: {DIED}"


def test_a_controller_that_is_lost_after_the_last_tip_path_is_recorded_and_does_not_fail_the_run() -> None:
    monitor = TipControlMonitor()
    list(monitor.events(0, 1.0, SetPointSource.PLAN, ""))
    (lost,) = monitor.events(1, 5.0, SetPointSource.PROTOCOL, DIED)
    assert DIED in lost.message
    assert not list(monitor.events(2, 9.0, SetPointSource.PROTOCOL, DIED))
    assert not monitor.message


def test_a_controller_without_plans_is_the_message_of_the_run() -> None:
    monitor = TipControlMonitor()
    list(monitor.events(0, 1.0, SetPointSource.LOST, ""))
    assert "no plan that could be followed for 1 s" in monitor.message
