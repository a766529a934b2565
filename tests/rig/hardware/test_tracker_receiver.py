"""Datagrams of a tracker: what is used, what is not and how it is counted, and the pose of the tip."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.config import loader
from rig.config.schema import RigConfig
from rig.config.sections import Placement
from rig.hardware.trackers.base import TrackerReading
from rig.hardware.trackers.datagram import BYTES, Datagram, DatagramError, decode, encode
from rig.hardware.trackers.receiver import TrackerReceiver, quaternion_of, rotation_of
from runs.records import DATAGRAM_COUNTS

HERE = ("127.0.0.1", 5005)
PERIOD_NS, DELAY_NS = 10_000_000, 2_000_000
COVARIANCE = np.diag([1e-8, 2e-8, 3e-8, 1e-6, 2e-6, 3e-6])
finite = st.floats(-1e3, 1e3)


def message(number: int, x_m: float = 0.01) -> Datagram:
    return Datagram(number, number * PERIOD_NS, True, np.array([x_m, 0, 0.17]), np.array([1.0, 0, 0, 0]), COVARIANCE)


def config(**keys: object) -> RigConfig:
    mock = loader.load("mock-tracker")
    return mock.model_copy(update={"trackers": {"pose": mock.trackers["pose"].model_copy(update=keys)}})


class Line:
    """A receiver that knows the sender's clock after 100 messages."""

    def __init__(self, **keys: object) -> None:
        self.receiver = TrackerReceiver(config(**keys), "pose", ("127.0.0.1", None))
        self.number = 0
        while self.number < 100:
            self.next()

    def next(self) -> TrackerReading | None:
        self.number += 1
        return self.send(message(self.number - 1))

    def send(self, sent: Datagram, late_ns: int = 0, sender: tuple[str, int] = HERE) -> TrackerReading | None:
        arrives_ns = sent.sent_ns + DELAY_NS + late_ns
        return self.receiver.receive(encode(sent), sender, arrives_ns)

    @property
    def counts(self) -> dict[str, int]:
        return {name: n for name, n in zip(DATAGRAM_COUNTS, self.receiver.counts, strict=True) if n}


@given(st.integers(0, 2**64 - 1), st.integers(-(2**63), 2**63 - 1), st.tuples(*[finite] * 7), st.booleans())
@settings(max_examples=50, deadline=None)
def test_every_datagram_is_read_back(sequence: int, sent_ns: int, numbers: tuple[float, ...], sees: bool) -> None:
    sent = Datagram(sequence, sent_ns, sees, np.array(numbers[:3]), np.array(numbers[3:]), COVARIANCE, 0.5)
    data = encode(sent)
    back = decode(data)
    assert len(data) == BYTES == 256
    assert (back.sequence, back.sent_ns, back.sees, back.quality) == (sequence, sent_ns, sees, 0.5)
    assert np.array_equal(back.position_m, sent.position_m)
    assert np.array_equal(back.quaternion, sent.quaternion)
    assert np.array_equal(back.covariance, COVARIANCE)


@given(st.integers(0, BYTES * 8 - 1))
@settings(max_examples=60, deadline=None)
def test_any_bit_that_flips_is_noticed(bit: int) -> None:
    data = bytearray(encode(message(7)))
    data[bit // 8] ^= 1 << bit % 8
    with pytest.raises(DatagramError):
        decode(bytes(data))


@given(st.tuples(*[st.floats(-3, 3)] * 3))
@settings(max_examples=50, deadline=None)
def test_rotations_and_quaternions_are_each_others_inverse(vector: tuple[float, float, float]) -> None:
    rotation = np.asarray(cv2.Rodrigues(np.array(vector))[0])
    assert rotation_of(quaternion_of(rotation)) == pytest.approx(rotation, abs=1e-9)


def test_a_pose_has_the_time_of_its_sender_on_our_clock() -> None:
    line = Line(delay_ms=2.0)
    reading = line.next()
    assert reading is not None
    assert reading.t_ns == pytest.approx(100 * PERIOD_NS, abs=1000)
    assert line.counts == {}


def test_doubled_reordered_and_lost_messages_are_counted_and_used_once() -> None:
    line = Line()
    assert line.send(message(102)) is not None
    assert line.counts == {"lost": 2}
    assert line.send(message(101), late_ns=12_000_000) is None
    assert line.counts == {"lost": 1, "reordered": 1}
    assert line.send(message(102)) is None
    assert line.send(message(101)) is None
    assert line.counts == {"lost": 1, "reordered": 1, "doubled": 2}


def test_a_message_that_comes_after_the_limit_is_late() -> None:
    line = Line(latest_ms=50.0)
    assert line.send(message(100), late_ns=70_000_000) is None
    assert line.counts == {"late": 1}
    assert line.send(message(101)) is not None


@pytest.mark.parametrize(
    ("forged", "reason"),
    [
        (replace(message(100), position_m=np.array([np.nan, 0, 0])), "implausible"),
        (replace(message(100), quaternion=np.array([0.5, 0, 0, 0])), "implausible"),
        (replace(message(100), covariance=-COVARIANCE), "implausible"),
        (message(100, x_m=5.0), "implausible"),
        (message(100, x_m=1e308), "implausible"),
        (replace(message(100), quaternion=np.array([1e308, 1e308, 0, 0])), "implausible"),
        (replace(message(100), covariance=np.full((6, 6), 1e308)), "implausible"),
        (replace(message(100), covariance=np.diag([1e300, 1, 1, 1, 1, 1])), "implausible"),
        (replace(message(100), sequence=2**40), "implausible"),
        (replace(message(100), sent_ns=10**15), "implausible"),
    ],
    ids=[
        "not finite",
        "no rotation",
        "no covariance",
        "out of reach",
        "position beyond all numbers",
        "quaternion beyond all numbers",
        "covariance beyond all numbers",
        "variance beyond all lengths",
        "sequence",
        "clock",
    ],
)
def test_a_forged_message_is_not_used_and_disturbs_nothing(forged: Datagram, reason: str) -> None:
    line = Line()
    assert line.receiver.receive(encode(forged), HERE, 100 * PERIOD_NS + DELAY_NS) is None
    assert line.counts == {reason: 1}
    assert line.send(message(101)) is not None


def test_a_message_that_came_is_not_lost_whatever_its_numbers_are() -> None:
    line = Line()
    for number, x_m in ((100, np.nan), (101, 5.0), (102, 0.01)):
        line.send(message(number, x_m))
    assert line.counts == {"implausible": 2}
    line.send(message(101, np.nan))
    assert line.counts == {"implausible": 2, "doubled": 1}


def test_only_the_stated_sender_is_used() -> None:
    line = Line()
    assert line.send(message(100), sender=("127.0.0.9", 5005)) is None
    assert line.counts == {"foreign": 1}
    assert line.send(message(100)) is not None


def test_a_sender_that_starts_anew_is_followed_again() -> None:
    line = Line()
    readings = []
    for k in range(60):
        anew = Datagram(k, 10**15 + k * PERIOD_NS, True, np.array([0, 0, 0.17]), np.array([1.0, 0, 0, 0]), COVARIANCE)
        readings.append(line.receiver.receive(encode(anew), HERE, (200 + k) * PERIOD_NS))
    assert readings[-1] is not None
    assert line.counts["clock_steps"] == 1


def test_the_tip_is_carried_through_body_and_placement_with_its_covariance() -> None:
    lever_mm = 100.0
    line = Line(body=Placement(translation_mm=(lever_mm, 0, 0)), placement=Placement(translation_mm=(0, 0, 10)))
    reading = line.next()
    assert reading is not None
    assert reading.position_m == pytest.approx([0.01 - lever_mm * 1e-3, 0, 0.18])
    # A turn about z and y moves the tip, at the end of the lever along x, in y and z.
    expected = np.diag(COVARIANCE)[:3] + np.array([0, 3e-6, 2e-6]) * (lever_mm * 1e-3) ** 2
    assert np.diag(reading.covariance)[:3] == pytest.approx(expected, rel=1e-6)
    assert reading.covariance[1, 5] == pytest.approx(-lever_mm * 1e-3 * 3e-6)


def test_an_unknown_delay_widens_the_covariance_along_the_motion() -> None:
    line = Line(delay_std_ms=5.0)
    line.send(message(100, x_m=0.011))
    reading = line.send(message(101, x_m=0.012))
    assert reading is not None
    # 0.1 m/s times 5 ms.
    assert reading.covariance[0, 0] == pytest.approx(1e-8 + (0.1 * 5e-3) ** 2, rel=1e-3)
    assert reading.covariance[1, 1] == pytest.approx(2e-8)


def test_a_body_that_the_tracker_does_not_see_is_a_reading_without_a_pose() -> None:
    line = Line()
    reading = line.send(replace(message(100), sees=False))
    assert reading is not None
    assert not reading.seen
    assert np.isnan(reading.position_m).all()


def readings_of(
    ahead_s: Callable[[float], float], jitter_ms: float
) -> tuple[list[tuple[float, float]], dict[str, int]]:
    """Time [s] of each pose that is used, with the error of its time [ms], and the counts; the clock changes at 5 s."""
    receiver, random = TrackerReceiver(config(delay_ms=2.0), "pose"), np.random.default_rng(5)
    found = []
    for k in range(1000):
        t_s = k * PERIOD_NS * 1e-9
        sent = replace(message(k), sent_ns=10**15 + k * PERIOD_NS + round(ahead_s(t_s) * 1e9))
        arrives_ns = k * PERIOD_NS + DELAY_NS + round(random.uniform(0, jitter_ms) * 1e6)
        if (reading := receiver.receive(encode(sent), HERE, arrives_ns)) is not None:
            found.append((t_s, reading.t_ns * 1e-6 - t_s * 1e3))
    return found, dict(zip(DATAGRAM_COUNTS, receiver.counts, strict=True))


@pytest.mark.parametrize("jitter_ms", [0.5, 5.0])
@pytest.mark.parametrize(
    "ahead_s",
    [
        lambda t_s: -2.0 * (t_s > 5),
        lambda t_s: 2.0 * (t_s > 5),
        lambda t_s: -0.05 * (t_s > 5),
        lambda t_s: 0.05 * (t_s > 5),
        lambda t_s: -2.0 * float(np.clip(t_s - 5, 0, 0.1)),
        lambda t_s: 2.0 * (5 < t_s < 5.3),
    ],
    ids=["2 s back", "2 s ahead", "50 ms back", "50 ms ahead", "runs backwards for 0.1 s", "ahead for 0.3 s"],
)
def test_no_pose_gets_a_wrong_time_while_a_clock_is_set(ahead_s: Callable[[float], float], jitter_ms: float) -> None:
    found, counts = readings_of(ahead_s, jitter_ms)
    assert max(abs(error_ms) for _, error_ms in found) < 1.0
    assert counts["clock_steps"] >= 1
    assert max(b - a for (a, _), (b, _) in pairwise(found)) < 1.2
    assert len(found) > 800


def test_a_clock_that_drifts_fast_is_followed_within_its_stated_limit() -> None:
    receiver = TrackerReceiver(config(delay_ms=2.0, largest_drift_ppm=1000.0), "pose")
    for k in range(2000):
        sent = replace(message(k), sent_ns=10**15 + round(k * PERIOD_NS * (1 + 500e-6)))
        reading = receiver.receive(encode(sent), HERE, k * PERIOD_NS + DELAY_NS + k % 7 * 100_000)
        assert reading is None or abs(reading.t_ns - k * PERIOD_NS) < 300_000
    assert reading is not None
    assert reading.clock.drift == pytest.approx(-500e-6, abs=10e-6)
    assert not any(receiver.counts)
