"""Monitors the process of the tip controller."""

from __future__ import annotations

from collections.abc import Iterator

from rig.realtime.process_group import ProcessGroup
from rig.realtime.shared_state import TIP_CONTROLLER, SharedState
from rig.tip_control.monitor import TipControlMonitor
from rig.tip_control.plan_follower import LOST_S
from runs.plan_counts import PlanCounts
from runs.records import Event

SILENT_NS = round(LOST_S * 0.5e9)
"""Time without a heartbeat from which the process counts as hung, if there are no plans."""


class TipControllerMonitor:
    """The monitor of the tip controller, with what its process and the shared memory say."""

    def __init__(self, processes: ProcessGroup, memory: SharedState) -> None:
        self._processes, self._memory = processes, memory
        self._monitor = TipControlMonitor()
        self._failure = ""

    def message(self, plans: PlanCounts) -> str:
        """What is wrong with the tip control of a run that has finished; empty if nothing is."""
        return self._monitor.message(plans)

    def events(self, t_ns: int) -> Iterator[Event]:
        """What has changed since the last call."""
        if not self._failure and (failure := self._processes.failure((TIP_CONTROLLER,))):
            died = self._processes.died(TIP_CONTROLLER)
            self._failure = failure.message + (self._processes.exit_status(TIP_CONTROLLER) if died else "")
        memory = self._memory
        responds = t_ns - memory.heartbeat_ns(TIP_CONTROLLER) < SILENT_NS
        return self._monitor.events(t_ns, memory.protocol_s, memory.setpoint_source, self._failure, responds=responds)
