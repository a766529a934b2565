"""Monitors the process of the tip controller."""

from __future__ import annotations

from collections.abc import Iterator

from rig.realtime.process_group import ProcessGroup
from rig.realtime.shared_state import TIP_CONTROLLER, SharedState
from rig.tip_control.monitor import TipControlMonitor
from runs.plan_counts import PlanCounts
from runs.records import Event


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
        return self._monitor.events(t_ns, self._memory.protocol_s, self._memory.setpoint_source, self._failure)
