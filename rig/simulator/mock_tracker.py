"""The mock tracker: datagrams of a simulated sender, with noise, delays and a clock of its own."""

from __future__ import annotations

import heapq
import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.vision.transforms import RigidTransform
from rig.config.optics import rigid
from rig.config.schema import RigConfig
from rig.config.tracker_sections import MockTrackerConfig
from rig.hardware.cards.base import CardError
from rig.hardware.trackers.base import TrackerError, TrackerReading
from rig.hardware.trackers.datagram import Datagram, encode
from rig.hardware.trackers.receiver import TrackerReceiver, quaternion_of
from rig.simulator.faults import CameraFault, Faults
from rig.simulator.registers import Registers
from rig.simulator.tip_pose import PoseSource

LEAD_S = 2.0
"""Virtual time: the sender runs for this long before the run begins, so that its clock is known."""
_SENDER = ("127.0.0.1", 1)
_CLOCK_ZERO_NS = 1_700_000_000_000_000_000
_OTHER_NOISE = 7_000_003


def open_mock_tracker(config: RigConfig, name: str, seed: int) -> MockTracker:
    """Open the mock tracker of the plant behind the rig's mock card, from any process.

    Raises:
        TrackerError: the rig has no mock card, or its plant does not run.
    """
    try:
        registers = Registers.behind(config.cards.values())
        return MockTracker(config, registers, name, seed, registers.faults, time.monotonic_ns())
    except CardError as error:
        raise TrackerError(f"tracker {name}: {error}") from error


class MockTracker:
    """A tracker that observes the tip of the simulator; `readings` serves virtual time, `read` real time."""

    def __init__(
        self, config: RigConfig, source: PoseSource, name: str, seed: int, faults: Faults, start_ns: int
    ) -> None:
        """The first message is of `start_ns`."""
        section = config.trackers[name]
        assert isinstance(section, MockTrackerConfig)
        assert config.simulator is not None
        self._section, self._source, self._faults = section, source, faults
        self._receiver = TrackerReceiver(config, name)
        self._random = np.random.default_rng(seed + _OTHER_NOISE)
        self._start_ns, self._period_ns = start_ns, round(1e9 / section.rate_hz)
        self._base, self._body = rigid(config.simulator.base), rigid(section.body)
        self._base_in_tracker = rigid(section.placement).inverse() @ self._base
        self._sent = 0
        self._under_way: list[tuple[int, int, bytes]] = []

    def readings(self, now_ns: int) -> list[TrackerReading]:
        """The readings of all messages that arrive until `now_ns`, in order."""
        found = []
        while (reading := self._next(now_ns)) is not None:
            found.append(reading)
        return found

    def read(self, timeout_s: float) -> TrackerReading | None:
        until_ns = time.monotonic_ns() + round(timeout_s * 1e9)
        while True:
            now_ns = time.monotonic_ns()
            found = self._next(now_ns)
            if found is not None:
                return found
            if now_ns >= until_ns:
                return None
            due_ns = min(self._start_ns + self._sent * self._period_ns, *(m[0] for m in self._under_way[:1]), until_ns)
            time.sleep(max(due_ns - now_ns, 0) * 1e-9)

    def _next(self, now_ns: int) -> TrackerReading | None:
        """The next reading of the messages that arrive until `now_ns`."""
        while (t_ns := self._start_ns + self._sent * self._period_ns) <= now_ns:
            self._send(self._sent, t_ns)
            self._sent += 1
        while self._under_way and self._under_way[0][0] <= now_ns:
            arrived_ns, _, data = heapq.heappop(self._under_way)
            reading = self._receiver.receive(data, _SENDER, arrived_ns)
            if reading is not None:
                return replace(reading, truth_m=self._truth_m(reading.t_ns))
        return None

    def pass_over(self, t_ns: int) -> None:
        self._receiver.pass_over(t_ns)

    def counts(self) -> tuple[int, ...]:
        return self._receiver.counts

    def close(self) -> None:
        """Nothing to release."""

    def _send(self, number: int, t_ns: int) -> None:
        section, random = self._section, self._random
        # Each message draws the same count of random numbers, so that a fault changes no later one.
        noise, jitter, chances = random.normal(size=6), random.exponential(size=2), random.random(2)
        if self._faults.camera(1) in (CameraFault.UNPLUGGED, CameraFault.SILENT) or chances[0] < section.lost:
            return
        try:
            pose = self._source.pose_at(t_ns)
        except LookupError:
            return  # the simulator has stalled: this pose is forgotten
        body = self._base_in_tracker @ RigidTransform(pose.rotation, pose.position_m) @ self._body
        std = np.repeat([section.noise_mm * 1e-3, np.deg2rad(section.noise_deg)], 3)
        turn = RigidTransform.from_vectors(noise[3:] * std[3:], (0.0, 0.0, 0.0))
        message = Datagram(
            number,
            self._clock_ns(t_ns),
            True,
            body.translation_m + noise[:3] * std[:3],
            quaternion_of(turn.rotation @ body.rotation),
            np.diag(std**2),
        )
        data = encode(message)
        for k in range(2 if chances[1] < section.doubled else 1):
            delay_ms = section.true_delay_ms + section.jitter_ms * float(jitter[k])
            heapq.heappush(self._under_way, (t_ns + round(delay_ms * 1e6), 2 * number + k, data))

    def _clock_ns(self, t_ns: int) -> int:
        """The sender's clock at one of our times."""
        passed_ns = t_ns - self._start_ns
        stepped = self._section.step_ms if passed_ns >= self._section.step_s * 1e9 else 0.0
        return _CLOCK_ZERO_NS + passed_ns + round(passed_ns * self._section.drift_ppm * 1e-6 + stepped * 1e6)

    def _truth_m(self, t_ns: int) -> NDArray[np.float64] | None:
        try:
            return self._base.apply(np.array(self._source.pose_at(t_ns).position_m, dtype=np.float64))
        except LookupError:
            return None
