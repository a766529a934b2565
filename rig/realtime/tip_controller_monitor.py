"""Reports the loss of the tip controller, which does not end a run: the set-points become those of the protocol."""

from __future__ import annotations

from collections.abc import Iterator

from rig.realtime.process_group import ProcessGroup
from rig.realtime.shared_state import TIP_CONTROLLER, SharedState
from rig.tip_control.plan_follower import LONGEST_S, LOST_S, SetPointSource
from runs.records import Event, Level

SOURCE = "tip controller"
_UNCONTROLLED = (SetPointSource.HELD, SetPointSource.LOST)


class TipControllerMonitor:
    """Monitors the process of the tip controller and the source of the set-points."""

    def __init__(self, processes: ProcessGroup, memory: SharedState) -> None:
        self._processes, self._memory = processes, memory
        self._source = SetPointSource.PROTOCOL
        self._since_s = 0.0
        self._died = ""
        self.message = ""
        """Why the tip was without its controller; empty if it was not, or only for an instant."""

    def events(self, t_ns: int) -> Iterator[Event]:
        """What has changed since the last call."""
        protocol_s, source = self._memory.protocol_s, self._memory.setpoint_source
        if not self._died and (failure := self._processes.failure((TIP_CONTROLLER,))):
            died = self._processes.died(TIP_CONTROLLER)
            self._died = failure.message + (self._processes.exit_status(TIP_CONTROLLER) if died else "")
            self._lost(protocol_s, self._died)
            yield Event(t_ns, Level.WARNING, SOURCE, f"{self._died}; the run continues without it")
        before, self._source = self._source, source
        if source == before:
            return
        if source is SetPointSource.HELD:
            self._since_s = protocol_s
            yield Event(t_ns, Level.WARNING, SOURCE, f"no plan for {LONGEST_S:g} s: the set-points are held")
        elif source is SetPointSource.LOST:
            self._lost(protocol_s, f"no plan that could be followed for {LOST_S:g} s")
            message = f"no plan for {LOST_S:g} s: the set-points return to those of the protocol (feed-forward)"
            yield Event(t_ns, Level.WARNING, SOURCE, message)
        elif source is SetPointSource.PLAN and before in _UNCONTROLLED:
            message = f"plans are followed again, after {protocol_s - self._since_s:.2f} s"
            yield Event(t_ns, Level.INFO, SOURCE, message)

    def _lost(self, protocol_s: float, reason: str) -> None:
        self.message = self.message or f"the tip lost its controller at {protocol_s:.2f} s of the protocol: {reason}"
