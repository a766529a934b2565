"""Reports the loss of the tip controller: the set-points become those of the protocol and the last correction."""

from __future__ import annotations

from collections.abc import Iterator

from rig.control.plan_follower import SetPointSource
from runs.columns import FOLLOWED_S
from runs.records import Event, Level
from runs.tip_plans import PlanCounts, refusals

SOURCE = "tip controller"
LOST_S = 1.0
"""Time without a plan from which the run states that the tip has lost its controller; a shorter one is a warning."""


def failure_message(error: BaseException) -> str:
    """The message of an exception in a controller."""
    return f"the tip controller failed: {type(error).__name__}: {error}"


class TipControlMonitor:
    """Monitors the tip controller and the source of the set-points."""

    def __init__(self) -> None:
        self._source = SetPointSource.PROTOCOL
        self._since_s = 0.0
        self._failure = ""
        self.loss = ""
        """Why the tip was without its controller; empty if it was not, or only for an instant."""

    def message(self, plans: PlanCounts) -> str:
        """What is wrong with the tip control of a run that has finished; empty if nothing is.

        Plans that were refused because they came late or after the path are no fault of the controller by themselves.
        """
        if not (refused := plans.refused) or not (self.loss or plans.at_fault):
            return self.loss
        count = f"{sum(refused.values())} of {plans.total} plans of the tip controller were refused"
        return f"{self.loss}; {count}: {refusals(refused)}".removeprefix("; ")

    def events(
        self, t_ns: int, protocol_s: float, source: SetPointSource, failure: str, *, responds: bool = True
    ) -> Iterator[Event]:
        """What has changed since the last call; `failure` says why there is no controller any more, else empty.

        `responds`: the controller, if it has a process of its own, is not hung or stopped.
        """
        if failure and not self._failure:
            self._failure = failure
            yield Event(t_ns, Level.WARNING, SOURCE, f"{failure}; the run continues without it")
        before, self._source = self._source, source
        if source is SetPointSource.LOST:
            if before is not SetPointSource.LOST:
                self._since_s = protocol_s
                message = (
                    f"no plan for {FOLLOWED_S:g} s: the tip is without feedback, the set-points are those of the "
                    "protocol and the last correction"
                )
                yield Event(t_ns, Level.WARNING, SOURCE, message)
            silent_s = protocol_s - self._since_s + FOLLOWED_S
            if not self.loss and (self._failure or silent_s >= LOST_S):
                no_plan = "no plan that could be followed" if responds else "its process does not respond: no plan"
                reason = self._failure or f"{no_plan} for {LOST_S:g} s"
                self.loss = f"the tip lost its controller at {self._since_s:.2f} s of the protocol: {reason}"
        elif before is SetPointSource.LOST and source is SetPointSource.PLAN:
            message = f"plans are followed again, after {protocol_s - self._since_s:.2f} s without feedback"
            yield Event(t_ns, Level.INFO, SOURCE, message)
