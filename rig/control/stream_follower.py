"""The set-points of another program in the control loop: those out of limits are refused."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from model.arrays import Array
from model.units import PA_PER_BAR
from protocols import SetPointTrajectory
from protocols.trajectory import StreamInterval
from rig.config.schema import RigConfig
from rig.control.interlocks.base import Silence
from rig.control.setpoints import Moment, SetPoint
from runs.columns import StreamStatus


class StreamLimits(NamedTuple):
    """Limits: the lowest and highest pressure [Pa], and equal values for the actuators (indices) on a valve."""

    lowest_pa: float
    pressure_pa: float
    valves: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, config: RigConfig) -> StreamLimits:
        valves = tuple(tuple(number - 1 for number in valve.actuators) for valve in config.valves)
        limits = config.limits
        return cls(limits.lowest_pressure_bar * PA_PER_BAR, limits.pressure_bar * PA_PER_BAR, valves)

    def kept(self, setpoint_pa: Array, interval: StreamInterval) -> bool:
        """Whether set-points (N,) of the actuators of an interval are within the limits."""
        named = setpoint_pa[[number - 1 for number in interval.actuators]]
        return (
            bool(np.isfinite(named).all() and (named >= self.lowest_pa).all() and (named <= self.pressure_pa).all())
            and self.unequal(setpoint_pa) is None
        )

    def unequal(self, setpoint_pa: Array) -> tuple[int, ...] | None:
        """The actuators (indices) of a valve whose set-points differ; None if there is no such valve."""
        return next(
            (v for v in self.valves if not np.isnan(setpoint_pa[v[0]]) and np.ptp(setpoint_pa[list(v)]) > 0.0), None
        )


class StreamPosition(NamedTuple):
    """The newest followed set-point: its connection and sequence number; (0, -1) before the first."""

    connection: int = 0
    sequence: int = -1


def stream_status(
    row: NDArray[np.void] | np.void, interval: StreamInterval | None, before: StreamPosition, limits: StreamLimits
) -> StreamStatus:
    """Whether a set-point (a row of `streamed_dtype`) may be followed in an interval, None outside of one."""
    if row["status"] != StreamStatus.FOLLOWED:
        return StreamStatus(int(row["status"]))
    if interval is None:
        return StreamStatus.NOT_NOW
    if not limits.kept(row["setpoint_pa"], interval):
        return StreamStatus.OUT_OF_LIMITS
    if row["connection"] == before.connection and row["sequence"] <= before.sequence:
        return StreamStatus.OUT_OF_ORDER
    return StreamStatus.FOLLOWED


class StreamFollower:
    """The set-points that another program sends in steps of the protocol."""

    def __init__(self, config: RigConfig, trajectory: SetPointTrajectory) -> None:
        self._trajectory = trajectory
        self._limits = StreamLimits.of(config)
        self._interval: StreamInterval | None = None
        self._newest = StreamPosition()
        self._setpoint_pa: Array | None = None
        self._silent_s = 0.0

    def take(
        self, row: NDArray[np.void] | np.void, now_ns: int, protocol_s: float, *, stopped: bool
    ) -> NDArray[np.void] | np.void:
        """Follow a set-point from now on, or refuse it; return its row for the record, completed."""
        interval = None if stopped else self._trajectory.stream_at(protocol_s)
        row["status"] = stream_status(row, interval, self._newest, self._limits)
        row["protocol_s"], row["late_s"] = protocol_s, (now_ns - row["t_ns"]) * 1e-9
        if row["status"] == StreamStatus.FOLLOWED:
            self._enter(interval)
            self._newest = StreamPosition(int(row["connection"]), int(row["sequence"]))
            self._setpoint_pa, self._silent_s = row["setpoint_pa"].copy(), 0.0
        return row

    def at(self, now: Moment, below: SetPoint) -> SetPoint | None:
        """The set-points (N,) of a cycle before any limit; None outside of the steps."""
        self._enter(self._trajectory.stream_at(now.protocol_s))
        if self._interval is None:
            return None
        if not now.stopped:
            self._silent_s += now.dt_s
        if self._setpoint_pa is None:  # the pressures stay
            wanted = below.pressure_pa if now.last_pa is None else now.last_pa
        else:
            wanted = np.where(np.isfinite(self._setpoint_pa), self._setpoint_pa, below.pressure_pa)
        # What comes next is not known, so a streamed set-point has no rate, as a step.
        return SetPoint(wanted, np.zeros_like(wanted))

    def skip(self) -> None:
        """The next cycle shows where the protocol goes on."""

    @property
    def silence(self) -> Silence | None:
        """For how long no set-point has come; None outside of a stream."""
        if self._interval is None:
            return None
        first = self._setpoint_pa is None
        what = "no program has sent a set-point" if first else f"no set-point after number {self._newest.sequence}"
        limit_s, key = self._interval.connect_s, "connect_s"
        if not first:
            limit_s, key = self._interval.timeout_s, "timeout_s"
        return Silence("stream", self._silent_s, limit_s, what, f"{key} of line {self._interval.line}")

    def _enter(self, interval: StreamInterval | None) -> None:
        if interval is not self._interval:
            self._interval, self._setpoint_pa, self._silent_s = interval, None, 0.0
