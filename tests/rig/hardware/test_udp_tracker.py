"""The UDP tracker on a real socket, with a sender whose clock drifts, and with others that send to its port."""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from ipaddress import IPv4Address

import numpy as np
import pytest

from rig.config import loader
from rig.config.schema import RigConfig
from rig.config.tracker_sections import UdpTrackerConfig
from rig.hardware.trackers import udp
from rig.hardware.trackers.base import Tracker, TrackerError, TrackerReading, open_tracker
from rig.hardware.trackers.datagram import Datagram, encode
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


def receive(tracker: Tracker, port: int, senders: list[socket.socket], numbers: Iterable[int]) -> list[TrackerReading]:
    """Let every sender send a pose each 5 ms; return the readings. The first one's pose is 0.17 m high, others' 0.1."""
    found = []
    for number in numbers:
        t_ns = time.monotonic_ns()
        for k, one in enumerate(senders):
            height = 0.1 if k else 0.17
            pose = Datagram(
                number, OFFSET_NS + t_ns, True, np.array([0, 0, height]), np.array([1.0, 0, 0, 0]), COVARIANCE
            )
            one.sendto(encode(pose), ("127.0.0.1", port))
        while (reading := tracker.read(0.001)) is not None:
            found.append(reading)
        time.sleep(max(0, t_ns + 5_000_000 - time.monotonic_ns()) * 1e-9)
    return found


@pytest.mark.parametrize("address", ["127.0.0.1", "127.0.0.2"])
def test_no_pose_of_a_second_sender_is_used_while_the_first_one_sends(address: str) -> None:
    port = free_port()
    with closing(open_tracker(rig(port=port), "pose")) as tracker, sender() as true, sender(address) as forger:
        before = receive(tracker, port, [true], range(MESSAGES))
        assert before
        assert before[-1].foreign_ipv4 == 0
        during = receive(tracker, port, [true, forger], range(MESSAGES, 2 * MESSAGES))
        assert during
        assert {reading.position_m[2] for reading in during} == {0.17}
        assert during[-1].foreign_ipv4 == int(IPv4Address(address))
        assert dict(zip(DATAGRAM_COUNTS, tracker.counts(), strict=True))["foreign"] >= MESSAGES // 2


def test_a_sender_that_is_started_anew_at_another_port_is_welcome() -> None:
    port = free_port()
    with closing(open_tracker(rig(port=port), "pose")) as tracker:
        with sender() as first:
            assert receive(tracker, port, [first], range(1000, 1000 + MESSAGES))
        time.sleep(0.55)
        with sender() as second:
            readings = receive(tracker, port, [second], range(2 * MESSAGES))
    assert readings
    assert readings[-1].foreign_ipv4 == 0


class Sender:
    """A sender on a real socket whose clock is ahead by a function of its time; messages pass at once."""

    def __init__(self, udp: socket.socket, port: int, tracker: Tracker) -> None:
        self._udp, self._port, self.tracker = udp, port, tracker
        self.readings: list[tuple[TrackerReading, int]] = []

    def send(self, numbers: Iterable[int], ahead_ns: int, drift: float = 0.0) -> None:
        """One message every 5 ms; what comes of it is kept with the true time of the newest message."""
        for number in numbers:
            t_ns = time.monotonic_ns()
            own_ns = OFFSET_NS + t_ns + ahead_ns + round((t_ns % 10**12) * drift)
            self.raw(number, own_ns)
            while (reading := self.tracker.read(0.001)) is not None:
                self.readings.append((reading, t_ns))
            time.sleep(max(0, t_ns + 5_000_000 - time.monotonic_ns()) * 1e-9)

    def raw(self, number: int, own_ns: int) -> None:
        """One message."""
        pose = Datagram(number, own_ns, True, np.array([0, 0, 0.17]), np.array([1.0, 0, 0, 0]), COVARIANCE)
        self._udp.sendto(encode(pose), ("127.0.0.1", self._port))

    def count(self, name: str) -> int:
        return dict(zip(DATAGRAM_COUNTS, self.tracker.counts(), strict=True))[name]


@pytest.fixture
def line() -> Iterator[Sender]:
    port = free_port()
    with closing(open_tracker(rig(port=port), "pose")) as tracker, sender() as udp:
        yield Sender(udp, port, tracker)


@pytest.mark.realtime
@pytest.mark.parametrize("drift", [0.0, 100e-6, 500e-6])
def test_times_hold_within_their_uncertainty_whatever_the_clock_drifts(line: Sender, drift: float) -> None:
    line.send(range(240), 0, drift)
    assert len(line.readings) > 50
    # The messages pass at once: a time is that of its sending, but for the way through the socket.
    wrong = [abs(r.t_ns - t_ns) * 1e-9 > 3 * r.time_std_s + 1e-3 for r, t_ns in line.readings]
    assert np.mean(wrong) < 0.2
    assert line.count("clock_steps") == 0


@pytest.mark.realtime
@pytest.mark.parametrize("step_ns", [10**9, -(10**9)])
def test_a_clock_that_is_set_is_followed_within_a_second(line: Sender, step_ns: int) -> None:
    line.send(range(150), 0)
    line.send(range(150, 400), step_ns)
    assert line.count("clock_steps") == 1
    reading, t_ns = line.readings[-1]
    assert abs(reading.t_ns - t_ns) < 20_000_000
    assert reading.index == 399
    # No time that the step made wrong by a second was given.
    assert max(abs(r.t_ns - t) for r, t in line.readings) < 200_000_000


@pytest.mark.realtime
def test_a_sender_that_starts_anew_counts_from_zero_and_is_followed(line: Sender) -> None:
    line.send(range(1000, 1150), 0)
    line.send(range(100), 7 * 10**15)
    assert line.count("clock_steps") == 1
    reading, t_ns = line.readings[-1]
    assert abs(reading.t_ns - t_ns) < 20_000_000
    indices = [r.index for r, _ in line.readings]
    assert np.all(np.diff(indices) > 0)


@pytest.mark.realtime
def test_messages_out_of_order_twice_and_late_give_one_pose_each_in_order_of_time(line: Sender) -> None:
    line.send(range(150), 0)
    known = len(line.readings)
    time.sleep(0.03)
    now_ns = OFFSET_NS + time.monotonic_ns()
    for number, age_ms in ((151, 20), (150, 25), (151, 20), (152, 15), (153, 300), (154, 0)):
        line.raw(number, now_ns - age_ms * 1_000_000)
    while (reading := line.tracker.read(0.01)) is not None:
        line.readings.append((reading, time.monotonic_ns()))
    used = [r.index for r, _ in line.readings[known:]]
    assert used == [151, 152, 154]
    assert (line.count("reordered"), line.count("doubled"), line.count("late")) == (1, 1, 1)
    assert np.all(np.diff([r.t_ns for r, _ in line.readings]) > 0)


def test_silence_gives_no_reading() -> None:
    with closing(open_tracker(rig(port=free_port()), "pose")) as tracker:
        assert tracker.read(0.02) is None


def test_a_port_that_is_taken_has_a_clear_message() -> None:
    port = free_port()
    with closing(open_tracker(rig(port=port), "pose")), pytest.raises(TrackerError, match=f"127.0.0.1:{port}"):
        open_tracker(rig(port=port), "pose")


class Clocks:
    """Both clocks of the machine, which show the same time; the process stops for some time before every look."""

    def __init__(self, stops_ns: int) -> None:
        self.now_ns, self._stops_ns = 10**12, stops_ns

    def read(self) -> int:
        self.now_ns += self._stops_ns
        return self.now_ns


def test_a_reader_that_is_stopped_between_two_clocks_makes_no_message_arrive_too_early(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The estimate follows the earliest arrivals: a late one has no effect on it."""
    clocks = Clocks(16_000_000)
    arrived_ns = clocks.now_ns
    monkeypatch.setattr(time, "monotonic_ns", clocks.read)
    monkeypatch.setattr(time, "time_ns", clocks.read)
    stamp = struct.pack("<qq", *divmod(arrived_ns, 10**9))
    found_ns = udp._arrival_ns([(socket.SOL_SOCKET, udp._SO_TIMESTAMPNS, stamp)])
    monkeypatch.undo()
    assert found_ns >= arrived_ns


def test_a_reader_that_comes_late_reads_on_to_the_pose_behind_messages_that_are_not_used(line: Sender) -> None:
    """Otherwise it takes a tracker that has sent for a silent one."""
    line.send(range(MESSAGES), ahead_ns=0)
    assert line.readings
    for _ in range(50):
        line._udp.sendto(b"noise", ("127.0.0.1", line._port))
    line.raw(MESSAGES, OFFSET_NS + time.monotonic_ns())
    reading = line.tracker.read(0.0)
    assert reading is not None
    assert reading.index == MESSAGES
