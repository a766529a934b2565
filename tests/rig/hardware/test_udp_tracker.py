"""The UDP tracker on a real socket, with a sender whose clock drifts, and with others that send to its port."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager

import numpy as np
import pytest

from rig.config import loader
from rig.config.schema import RigConfig
from rig.config.tracker_sections import UdpTrackerConfig
from rig.hardware.trackers.base import TrackerError, TrackerReading
from rig.hardware.trackers.datagram import Datagram, encode
from rig.hardware.trackers.registry import open_tracker
from runs.records import DATAGRAM_COUNTS

MESSAGES, READINGS, MOST_MESSAGES = 120, 10, 1200
DRIFT, OFFSET_NS = 100e-6, 5 * 10**17
COVARIANCE = np.diag([1e-8] * 3 + [1e-6] * 3)


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def rig(**keys: object) -> RigConfig:
    section = UdpTrackerConfig.model_validate({"driver": "udp", "rate_hz": 200.0, **keys})
    return loader.load("mock-tracker").model_copy(update={"trackers": {"pose": section}})


@contextmanager
def sender(address: str = "127.0.0.1") -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.bind((address, 0))
        yield udp


def datagram(number: int, t_ns: int) -> bytes:
    own_ns = OFFSET_NS + t_ns + round((t_ns % 10**12) * DRIFT)
    return encode(Datagram(number, own_ns, True, np.array([0, 0, 0.17]), np.array([1.0, 0, 0, 0]), COVARIANCE))


def test_poses_come_through_a_socket_at_the_time_of_the_pose() -> None:
    port = free_port()
    found: list[tuple[TrackerReading, int]] = []
    with closing(open_tracker(rig(port=port), "pose")) as tracker, sender() as udp, sender("127.0.0.2") as other:
        for number in range(MOST_MESSAGES):
            t_ns = time.monotonic_ns()
            udp.sendto(datagram(number, t_ns), ("127.0.0.1", port))
            other.sendto(datagram(number, t_ns), ("127.0.0.1", port))
            udp.sendto(b"noise", ("127.0.0.1", port))
            reading = tracker.read(0.005)
            if reading is not None:
                found.append((reading, t_ns))
            if len(found) >= READINGS and number >= MESSAGES:
                break
            time.sleep(max(0, t_ns + 5_000_000 - time.monotonic_ns()) * 1e-9)
        counts = dict(zip(DATAGRAM_COUNTS, tracker.counts(), strict=True))
    assert len(found) >= READINGS
    reading, t_ns = found[-1]
    assert abs(reading.t_ns - t_ns) < 20_000_000
    assert reading.clock.offset_s == pytest.approx(-OFFSET_NS * 1e-9, rel=1e-5)
    assert counts["foreign"] > MESSAGES / 2
    assert counts["malformed"] > MESSAGES / 2
    assert counts["lost"] == 0


def test_silence_gives_no_reading() -> None:
    with closing(open_tracker(rig(port=free_port()), "pose")) as tracker:
        assert tracker.read(0.02) is None


def test_a_port_that_is_taken_has_a_clear_message() -> None:
    port = free_port()
    with closing(open_tracker(rig(port=port), "pose")), pytest.raises(TrackerError, match=f"127.0.0.1:{port}"):
        open_tracker(rig(port=port), "pose")
