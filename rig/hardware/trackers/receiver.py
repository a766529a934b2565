"""Receiver of datagrams: sorts out those that cannot be used, estimates the sender's clock, gives tip poses.

It uses no clock and no socket: bytes, sender and time of arrival come from the caller, in real and in virtual time.
"""

from __future__ import annotations

from collections import OrderedDict
from ipaddress import IPv4Address

import numpy as np

from calibration.rotation_vectors import cross_matrix
from calibration.vision.transforms import RigidTransform
from model.arrays import Array
from rig.config.optics import rigid
from rig.config.schema import RigConfig
from rig.hardware.trackers.base import TrackerReading
from rig.hardware.trackers.datagram import Datagram, DatagramError, decode
from rig.hardware.trackers.sender_clock import SenderClock
from runs.records import DATAGRAM_COUNTS

REMEMBERED = 1024
"""Sequence numbers in which a doubled or reordered message is recognised."""
FURTHEST = 10_000
"""A sequence number that is farther ahead is not that of the next messages."""
RESTART_MESSAGES = 10
"""Messages in a row that continue each other, but not those before: the sender was restarted."""
RESTART_S = 0.5
"""A sender that is silent for so long may come again from another port: a program that is started anew gets one. Longer
than a busy computer keeps a sender from running, and less than a run bears without a pose."""
_LENGTHS = 3.0
_SPEED_SPAN_S = 0.5
"""The tip's speed comes from poses at most this far apart."""


def rotation_of(quaternion: Array) -> Array:
    """Rotation matrix (3, 3) of a quaternion (w, x, y, z), which is normalised here."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_of(rotation: Array) -> Array:
    """Quaternion (w, x, y, z), w >= 0, of a rotation matrix (Shepperd's method by the largest eigenvector)."""
    r = rotation
    k = np.array(
        [
            [r[0, 0] + r[1, 1] + r[2, 2], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], r[0, 0] - r[1, 1] - r[2, 2], r[1, 0] + r[0, 1], r[2, 0] + r[0, 2]],
            [r[0, 2] - r[2, 0], r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], r[2, 1] + r[1, 2]],
            [r[1, 0] - r[0, 1], r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1]],
        ]
    )
    found = np.linalg.eigh(k)[1][:, -1]
    return np.asarray(found if found[0] >= 0 else -found)


class _LatchedSender:
    """The one sender whose messages are used: the first, until it is silent and another port of its address sends.

    Without the port every program of the same computer could put poses between those of the sender.
    """

    def __init__(self, address: str, port: int | None) -> None:
        """An empty address is that of the first message, a port None likewise."""
        self._stated = address, port
        self._latched: tuple[str, int] | None = None
        self._heard_ns = self._waiting = 0
        self.foreign = 0
        """Messages of others."""
        self.foreign_ipv4 = 0
        """Address of the last other sender as one number; 0 without one."""

    def takes(self, sender: tuple[str, int], arrived_ns: int) -> bool:
        """Whether the message of a sender is used."""
        address, port = self._stated
        latched = self._latched or sender
        if sender[0] != (address or latched[0]) or port not in (None, sender[1]):
            self._note(1, sender[0])
            return False
        if sender[1] != latched[1] and arrived_ns - self._heard_ns <= RESTART_S * 1e9:
            # Of a sender that was restarted, unless the first one goes on.
            self._waiting += 1
            return False
        if sender == latched:
            self._note(self._waiting, sender[0])
        self._latched, self._heard_ns, self._waiting = sender, arrived_ns, 0
        return True

    def _note(self, messages: int, address: str) -> None:
        if messages:
            self.foreign += messages
            self.foreign_ipv4 = int(IPv4Address(address))


class TrackerReceiver:
    """The messages of one tracker, in the order of their arrival."""

    def __init__(self, config: RigConfig, name: str, sender: tuple[str, int | None] = ("", None)) -> None:
        """`sender` is the address and port whose messages are used; port None is that of the first message."""
        section = config.trackers[name]
        self._sender = _LatchedSender(*sender)
        self._placement, self._body = rigid(section.placement), rigid(section.body)
        self._delay_ns, self._delay_std_s = round(section.delay_ms * 1e6), section.delay_std_ms * 1e-3
        self._latest_ns = round(section.latest_ms * 1e6)
        self._reach_m = (section.reach_mm or _LENGTHS * config.arm.length_mm) * 1e-3
        self._largest_drift = section.largest_drift_ppm * 1e-6
        self._clock = SenderClock(self._largest_drift)
        self._counts = dict.fromkeys(DATAGRAM_COUNTS, 0)
        self._newest: int | None = None
        self._first = 0
        self._recent: OrderedDict[int, int] = OrderedDict()
        self._restarted: list[tuple[int, int, int]] = []
        self._given_ns: int | None = None
        self._index = -1
        self._before: tuple[int, Array] | None = None

    @property
    def ready(self) -> bool:
        """True once the sender's clock is known."""
        return self._clock.ready

    @property
    def counts(self) -> tuple[int, ...]:
        """`DATAGRAM_COUNTS` so far."""
        return tuple(self._counts.values())

    def pass_over(self, t_ns: int) -> None:
        """State that a time has been given as one without a measurement: messages of earlier poses are late."""
        self._given_ns = t_ns if self._given_ns is None else max(self._given_ns, t_ns)

    def receive(self, data: bytes, sender: tuple[str, int], arrived_ns: int) -> TrackerReading | None:
        """Take one datagram; return its reading, None where it gives none."""
        try:
            message = decode(data)
        except DatagramError:
            self._reject("malformed")
            return None
        own = self._sender.takes(sender, arrived_ns)
        self._counts["foreign"] = self._sender.foreign
        if not own:
            return None
        # Its number first: a message whose pose is not used has come, and is not lost.
        if not self._follows(message, arrived_ns):
            return None
        if not message.plausible:
            self._reject("implausible")
            return None
        tip, covariance = self._tip(message)
        if message.sees and np.linalg.norm(tip.translation_m) > self._reach_m:
            self._reject("implausible")
            return None
        used = self._clock.add(message.sent_ns, arrived_ns)
        self._counts["clock_steps"] = self._steps()
        if not self._clock.ready:
            if not used:
                self._reject("implausible")
            return None
        t_ns = self._clock.ours_ns(message.sent_ns) - self._delay_ns
        if arrived_ns - t_ns > self._latest_ns or (used and self._given_ns is not None and t_ns <= self._given_ns):
            self._reject("late")
            return None
        if not used:
            self._reject("implausible")
            return None
        self._given_ns = t_ns
        return self._reading(message, t_ns, tip, covariance)

    def _reject(self, reason: str) -> None:
        self._counts[reason] += 1

    def _steps(self) -> int:
        return self._first + self._clock.steps

    def _follows(self, message: Datagram, arrived_ns: int) -> bool:
        """Whether a message is the next one of its sender; counts those that were lost before it."""
        number, newest = message.sequence, self._newest
        if newest is None or newest < number <= newest + FURTHEST:
            self._restarted = []
            self._index += 1 if newest is None else number - newest
            self._counts["lost"] += 0 if newest is None else number - newest - 1
            self._newest = number
            self._remember(number, message.sent_ns)
            return True
        if self._recent.get(number) == message.sent_ns:
            self._reject("doubled")
        elif number < newest and min(self._recent.values()) < message.sent_ns < self._recent[newest]:
            self._remember(number, message.sent_ns)
            self._counts["lost"] -= 1 if self._counts["lost"] else 0
            self._reject("reordered")
        else:
            self._follow_restart(message, arrived_ns)
        return False

    def _remember(self, number: int, sent_ns: int) -> None:
        self._recent[number] = sent_ns
        if len(self._recent) > REMEMBERED:
            self._recent.popitem(last=False)

    def _follow_restart(self, message: Datagram, arrived_ns: int) -> None:
        """Follow a sender that was restarted, once several of its messages continue each other."""
        self._reject("implausible")
        heard = message.sequence, message.sent_ns, arrived_ns
        if self._restarted and not (self._restarted[-1][0] < heard[0] <= self._restarted[-1][0] + REMEMBERED):
            self._restarted = []
        self._restarted.append(heard)
        if len(self._restarted) < RESTART_MESSAGES:
            return
        self._first = self._steps() + 1
        self._counts["clock_steps"] = self._first
        self._clock = SenderClock(self._largest_drift)
        for _, sent_ns, at_ns in self._restarted:
            self._clock.add(sent_ns, at_ns)
        self._newest, self._before = heard[0], None
        self._recent = OrderedDict((number, sent_ns) for number, sent_ns, _ in self._restarted)
        self._index += 1
        self._restarted = []

    def _tip(self, message: Datagram) -> tuple[RigidTransform, Array]:
        """The tip in the rod-base frame with its covariance (6, 6); NaN where the tracker sees nothing."""
        if not message.sees:
            return RigidTransform(np.full((3, 3), np.nan), np.full(3, np.nan)), np.full((6, 6), np.nan)
        pose = RigidTransform(rotation_of(message.quaternion), message.position_m)
        tip = pose @ self._body.inverse()
        lever_m = tip.translation_m - pose.translation_m
        by_pose = np.block([[np.eye(3), -cross_matrix(lever_m)], [np.zeros((3, 3)), np.eye(3)]])
        covariance = by_pose @ message.covariance @ by_pose.T + self._body.error_covariance(lever_m)
        return self._placement.transport_pose(tip, covariance)

    def _reading(self, message: Datagram, t_ns: int, tip: RigidTransform, covariance: Array) -> TrackerReading:
        clock = self._clock.estimate(message.sent_ns)
        std_s = float(np.hypot(clock.std_s, self._delay_std_s))
        if message.sees:
            before, self._before = self._before, (t_ns, tip.translation_m)
            if before is not None and t_ns - before[0] < _SPEED_SPAN_S * 1e9:
                # An error of the time is an error of the position along the motion.
                step_m = (tip.translation_m - before[1]) / ((t_ns - before[0]) * 1e-9) * std_s
                covariance = covariance.copy()
                covariance[:3, :3] += np.outer(step_m, step_m)
        return TrackerReading(
            self._index,
            t_ns,
            message.sees,
            tip.translation_m,
            tip.rotation,
            covariance,
            clock,
            std_s,
            self.counts,
            self._sender.foreign_ipv4,
        )
