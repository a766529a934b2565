"""Receives the set-points that another program streams, over the control socket, during a step `stream`.

It judges each set-point for the answer and for the events; the control process judges it again and keeps within the
limits of the rig.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from model.units import PA_PER_BAR
from protocols.trajectory import StreamInterval
from rig.control.stream_follower import StreamLimits, StreamPosition, stream_status
from rig.execution.plan import RunPlan
from rig.realtime.shared_state import SharedState
from runs.columns import StreamStatus
from runs.records import DetectionStatus, Level, blank, streamed_dtype

SOURCE = "stream"
QUIET_S = 1.0
"""Least time between two events about refused or lost set-points."""
MOST_SEQUENCE = 2**53
"""Sequence numbers are below this: a double, the only number of many programs, holds each of them exactly."""
MOST_COUNTED = 2**63 - 1
"""Largest count that an archive holds."""
LARGEST_BAR = 1e6

Answer = dict[str, Any]
RecordEvent = Callable[[Level, str, str], None]


class _MalformedError(ValueError):
    """A packet that is no set-point; the message says what is expected."""


@dataclass
class _Client:
    """One connection that has sent set-points: how many, and what became of them."""

    sender: str
    sequence: int = -1
    """Sequence number of the newest set-point that was followed."""
    arrived: int = -1
    """The largest sequence number that has arrived, followed or refused."""
    followed: int = 0
    refused: int = 0
    lost: int = 0

    def arrives(self, sequence: int) -> int:
        """Take the sequence number of a packet; return how many were lost between the one before and it."""
        lost = max(0, sequence - self.arrived - 1) if self.arrived >= 0 else 0
        self.arrived, self.lost = max(self.arrived, sequence), self.lost + lost
        return lost


class StreamReceiver:
    """The set-points of one run. The first program that sends one in a step has the step until it disconnects."""

    def __init__(self, plan: RunPlan, memory: SharedState, event: RecordEvent) -> None:
        self._plan, self._memory, self._event = plan, memory, event
        self._limits = StreamLimits.of(plan.config)
        self._row = blank((), streamed_dtype(plan.config.actuators))
        self._clients: dict[int, _Client] = {}
        self._interval: StreamInterval | None = None
        self._reported: StreamInterval | None = None
        self._owner = 0
        self._reported_s = 0.0
        self._refusing = self._refused = self._lost = 0

    @property
    def counts(self) -> dict[str, int]:
        """Lost and refused set-points of the run; empty for a protocol without a step `stream`."""
        if not self._plan.trajectory.streams:
            return {}
        return {"lost_setpoints": min(self._lost, MOST_COUNTED), "refused_setpoints": self._refused}

    def update(self, place: str) -> None:
        """Report that a step waits for set-points at the socket `place`; called in every cycle of the supervisor."""
        interval = self._plan.trajectory.stream_at(self._memory.protocol_s) if self._memory.start_ns else None
        self._enter(interval)
        if interval is self._reported:
            return
        self._reported = interval
        if interval is not None:
            message = f"waiting at most {interval.connect_s:g} s for set-points of {_actuators(interval)} at {place}"
            self._event(Level.INFO, SOURCE, message)

    def take(self, connection: int, sender: str, packet: Mapping[str, Any]) -> Answer:
        """Pass a set-point on to control; return the answer to its sender: what became of it, and `state`."""
        if not self._memory.start_ns:
            return {"done": False, "message": "the run has not begun", **self.state()}
        client = self._clients.setdefault(connection, _Client(sender))
        interval = self._open_interval()
        if interval is not None:
            self._enter(interval)
        row = self._row
        row["connection"], row["t_ns"], row["status"] = connection, time.monotonic_ns(), StreamStatus.FOLLOWED
        try:
            row["sequence"] = sequence = _sequence(packet)
            lost = client.arrives(sequence)
            self._lost += lost
            row["setpoint_pa"] = self._setpoint_pa(interval, packet)
        except _MalformedError as error:
            self._refuse(client, f"a set-point of {sender} is refused: {error}")
            return {"done": False, "message": str(error), **self.state()}
        if interval is not None and self._owner not in (0, connection):
            row["status"] = StreamStatus.OTHER_CLIENT
        before = StreamPosition(connection, client.sequence)
        row["status"] = stream_status(row, interval, before, self._limits)
        self._memory.new_setpoints.push(row)
        reason = self._reason(StreamStatus(int(row["status"])), client, packet)
        if reason:
            self._refuse(client, f"set-point {sequence} of {sender} is refused: {reason}")
        else:
            self._follow(connection, client, sequence, interval, lost)
        return {"done": not reason, "message": reason, "sequence": sequence, **self.state()}

    def disconnected(self, connection: int) -> None:
        """Report the end of a connection that has sent set-points; another program may continue."""
        client = self._clients.pop(connection, None)
        if client is None:
            return
        self._owner = 0 if self._owner == connection else self._owner
        counts = f"{client.followed} set-points followed, {client.refused} refused, {client.lost} lost"
        self._event(Level.INFO, SOURCE, f"{client.sender} has disconnected: {counts}")

    def state(self) -> Answer:
        """What a program needs for its next set-point: time, pressures, tip, and the step that waits for set-points."""
        memory, limits = self._memory, self._plan.config.limits
        samples, frames = memory.samples.last(1), memory.observations.last(1)
        interval, tip = self._open_interval(), None
        if len(frames) and frames[0]["seen"] == DetectionStatus.MEASURED:
            tip = (frames[0]["measured_m"] * 1e3).tolist()
        waiting = interval and {
            "actuators": list(interval.actuators),
            "left_s": interval.stop_s - memory.protocol_s,
            "timeout_s": interval.timeout_s,
            "pressure_bar": limits.pressure_bar,
            "rate_bar_per_s": limits.rate_bar_per_s,
        }
        return {
            "protocol_s": memory.protocol_s,
            "pressure_bar": (samples[0]["measured_pa"] / PA_PER_BAR).tolist() if len(samples) else None,
            "setpoint_bar": (samples[0]["setpoint_pa"] / PA_PER_BAR).tolist() if len(samples) else None,
            "tip_mm": tip,
            "tip_age_s": None if tip is None else (time.monotonic_ns() - int(frames[0]["t_ns"])) * 1e-9,
            "stream": waiting,
        }

    def _enter(self, interval: StreamInterval | None) -> None:
        """Begin a step, which has no sender yet; a set-point may come before `update` notices the step."""
        if interval is not self._interval:
            self._interval, self._owner = interval, 0

    def _open_interval(self) -> StreamInterval | None:
        """The step that waits for set-points now; None before, after and in a pause."""
        if not self._memory.start_ns or self._memory.paused:
            return None
        return self._plan.trajectory.stream_at(self._memory.protocol_s)

    def _setpoint_pa(self, interval: StreamInterval | None, packet: Mapping[str, Any]) -> NDArray[np.float64]:
        values = packet.get("setpoint_bar")
        if (
            not isinstance(values, list)
            or not all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
            or (interval is not None and len(values) != len(interval.actuators))
        ):
            wanted = _actuators(interval) if interval is not None else "the actuators of the step"
            raise _MalformedError(f"setpoint_bar is expected to be a list of numbers [bar], one for each of {wanted}")
        setpoint = np.full(self._plan.config.actuators, np.nan)
        if interval is not None:
            for number, value in zip(interval.actuators, values, strict=True):
                bar = _bar(value)
                setpoint[number - 1] = bar * PA_PER_BAR if math.isfinite(bar) else math.nan
        return setpoint

    def _reason(self, status: StreamStatus, client: _Client, packet: Mapping[str, Any]) -> str:
        """Why a set-point is not followed; empty for one that is."""
        match status:
            case StreamStatus.FOLLOWED:
                return ""
            case StreamStatus.OUT_OF_LIMITS:
                given = ", ".join(f"{_bar(value):.6g}" for value in packet["setpoint_bar"])
                if (unequal := self._limits.unequal(self._row["setpoint_pa"])) is not None:
                    names = " and ".join(str(index + 1) for index in unequal)
                    return f"{given} bar; actuators {names} are on one valve: the same pressure is expected"
                lowest, highest = (pa / PA_PER_BAR for pa in (self._limits.lowest_pa, self._limits.pressure_pa))
                return f"{given} bar; expected {lowest:g} to {highest:g} bar (limits, pressure_bar)"
            case StreamStatus.OUT_OF_ORDER:
                above = f"a sequence number above {client.sequence} is expected"
                return f"{above}: connect again to begin with a lower one"
            case StreamStatus.OTHER_CLIENT:
                return f"{self._clients[self._owner].sender} sends the set-points of this step"
            case StreamStatus.NOT_NOW:
                return "the run is paused" if self._memory.paused else "the protocol is not at a step stream"

    def _follow(
        self, connection: int, client: _Client, sequence: int, interval: StreamInterval | None, lost: int
    ) -> None:
        assert interval is not None
        if not self._owner:
            self._owner = connection
            self._event(Level.INFO, SOURCE, f"{client.sender} sends the set-points of {_actuators(interval)}")
        client.followed, client.sequence = client.followed + 1, sequence
        if lost and self._may_report():
            message = f"set-points {sequence - lost} to {sequence - 1} of {client.sender} did not arrive"
            self._event(Level.WARNING, SOURCE, f"{message}; the run continues")
        if self._refusing and self._may_report():
            self._event(Level.INFO, SOURCE, f"set-points are followed again, after {self._refusing} refused ones")
            self._refusing = 0

    def _refuse(self, client: _Client, message: str) -> None:
        client.refused, self._refusing, self._refused = client.refused + 1, self._refusing + 1, self._refused + 1
        if self._may_report():
            self._event(Level.WARNING, SOURCE, f"{message}; the set-points stay")

    def _may_report(self) -> bool:
        """Whether an event may be recorded now: a program that sends nonsense must not fill the record."""
        now_s = time.monotonic()
        due = now_s - self._reported_s > QUIET_S
        self._reported_s = now_s if due else self._reported_s
        return due


def _sequence(packet: Mapping[str, Any]) -> int:
    sequence = packet.get("sequence")
    if not isinstance(sequence, int) or isinstance(sequence, bool) or not 0 <= sequence < MOST_SEQUENCE:
        expected = f"an integer from 0 to {MOST_SEQUENCE - 1}, higher for each set-point"
        raise _MalformedError(f"sequence is expected to be {expected}")
    return sequence


def _bar(value: float) -> float:
    """A pressure [bar] as it was sent; a JSON integer may be larger than any float."""
    if abs(value) >= LARGEST_BAR:
        return math.inf if value > 0 else -math.inf
    return float(value)


def _actuators(interval: StreamInterval) -> str:
    numbers = ", ".join(map(str, interval.actuators))
    return f"actuator {numbers}" if len(interval.actuators) == 1 else f"actuators {numbers}"
