"""Reports the loss of the tip controller, which does not end a run: the set-points become those of the protocol."""

from __future__ import annotations

from collections.abc import Iterator

from rig.tip_control.plan_follower import LONGEST_S, LOST_S, SetPointSource
from runs.records import Event, Level
from runs.tip_plans import PlanCounts, refusals

SOURCE = "tip controller"
_UNCONTROLLED = (SetPointSource.HELD, SetPointSource.LOST)


def failure_message(error: BaseException) -> str:
    """The message of an exception in a controller."""
    return f"the tip controller failed: {type(error).__name__}: {error}"


class TipControlMonitor:
    """Monitors the tip controller and the source of the set-points."""

    def __init__(self) -> None:
        self._source = SetPointSource.PROTOCOL
        self._since_s = 0.0
        self._failure = ""
        self._loss = ""
        """Why the tip was without its controller; empty if it was not, or only for an instant."""

    def message(self, plans: PlanCounts) -> str:
        """What is wrong with the tip control of a run that has finished; empty if nothing is.

        Plans that were refused because they came late or after the path are no fault of the controller by themselves.
        """
        if not (refused := plans.refused) or not (self._loss or plans.at_fault):
            return self._loss
        count = f"{sum(refused.values())} of {plans.total} plans of the tip controller were refused"
        return f"{self._loss}; {count}: {refusals(refused)}".removeprefix("; ")

    def events(
        self, t_ns: int, protocol_s: float, source: SetPointSource, failure: str, *, responds: bool = True
    ) -> Iterator[Event]:
        """What has changed since the last call; `failure` says why there is no controller any more, else empty.

        `responds`: the controller, if it has a process of its own, is not hung or stopped.
        """
        if failure and not self._failure:
            self._failure = failure
            yield Event(t_ns, Level.WARNING, SOURCE, f"{failure}; the run continues without it")
        if self._failure and source in _UNCONTROLLED:
            self._lost(protocol_s, self._failure)
        before, self._source = self._source, source
        if source == before:
            return
        if source is SetPointSource.HELD:
            self._since_s = protocol_s
            yield Event(t_ns, Level.WARNING, SOURCE, f"no plan for {LONGEST_S:g} s: the set-points are held")
        elif source is SetPointSource.LOST:
            no_plan = "no plan that could be followed" if responds else "its process does not respond: no plan"
            since_s = self._since_s if before is SetPointSource.HELD else protocol_s
            self._lost(since_s, f"{no_plan} for {LOST_S:g} s")
            message = f"no plan for {LOST_S:g} s: the set-points return to those of the protocol (feed-forward)"
            yield Event(t_ns, Level.WARNING, SOURCE, message)
        elif source is SetPointSource.PLAN and before in _UNCONTROLLED:
            message = f"plans are followed again, after {protocol_s - self._since_s:.2f} s"
            yield Event(t_ns, Level.INFO, SOURCE, message)

    def _lost(self, protocol_s: float, reason: str) -> None:
        self._loss = self._loss or f"the tip lost its controller at {protocol_s:.2f} s of the protocol: {reason}"
