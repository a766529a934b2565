"""Sequence numbers of streamed set-points: what a gap, a jump and a refused number count as."""

from __future__ import annotations

from typing import Any

import pytest

import protocols
from rig.config.loader import load, path_of
from rig.execution.plan import RunPlan
from rig.realtime.shared_state import SharedState
from rig.realtime.stream_receiver import MOST_SEQUENCE, StreamReceiver
from runs.columns import StreamStatus
from runs.records import Level

LARGEST = MOST_SEQUENCE - 1


class Received:
    """A receiver in a step `stream`, and the events that it records."""

    def __init__(self) -> None:
        config = load("mock-3")
        steps = [{"stream": {"actuators": [1, 2, 3], "duration_s": 20}}]
        trajectory = protocols.from_steps("t", steps).expand(3)
        plan = RunPlan(config, path_of("mock-3"), trajectory, config.model.variant, 0)
        self.memory = SharedState.create(config)
        self.memory.start_ns, self.memory.protocol_s = 1, 1.0
        self.events: list[tuple[Level, str]] = []
        self.receiver = StreamReceiver(plan, self.memory, lambda level, _, text: self.events.append((level, text)))

    def send(self, sequence: object, *levels: float, connection: int = 1) -> dict[str, Any]:
        packet = {"sequence": sequence, "setpoint_bar": list(levels or (0.1, 0.1, 0.1))}
        return self.receiver.take(connection, f"program {connection}", packet)

    @property
    def statuses(self) -> list[StreamStatus]:
        return [StreamStatus(int(row["status"])) for row in self.memory.new_setpoints.read()]


@pytest.fixture
def received() -> Received:
    return Received()


def test_a_jump_of_the_sequence_number_is_followed_and_what_it_passes_over_counts_as_lost(received: Received) -> None:
    for sequence in (5, 6, 10):
        assert received.send(sequence)["done"]
    assert received.receiver.counts == {"lost_setpoints": 3, "refused_setpoints": 0}
    assert (Level.WARNING, "set-points 7 to 9 of program 1 did not arrive; the run continues") in received.events
    received.receiver.disconnected(1)
    assert received.events[-1] == (Level.INFO, "program 1 has disconnected: 3 set-points followed, 0 refused, 3 lost")


def test_after_a_jump_lower_numbers_are_refused_until_the_program_connects_again(received: Received) -> None:
    assert received.send(1)["done"]
    assert received.send(LARGEST)["done"]
    answer = received.send(2)
    assert not answer["done"]
    assert (
        answer["message"] == f"a sequence number above {LARGEST} is expected: connect again to begin with a lower one"
    )
    received.receiver.disconnected(1)
    assert received.send(0, connection=2)["done"]
    assert received.statuses == [
        StreamStatus.FOLLOWED, StreamStatus.FOLLOWED, StreamStatus.OUT_OF_ORDER, StreamStatus.FOLLOWED,
    ]  # fmt: skip
    assert received.receiver.counts == {"lost_setpoints": LARGEST - 2, "refused_setpoints": 1}


@pytest.mark.parametrize("sequence", [MOST_SEQUENCE, 2**63, 10**400, -1, 1.0, True, None, "7"])
def test_a_sequence_number_that_a_double_does_not_hold_is_refused_with_what_is_expected(
    received: Received, sequence: object
) -> None:
    answer = received.send(sequence)
    assert not answer["done"]
    assert answer["message"] == f"sequence is expected to be an integer from 0 to {LARGEST}, higher for each set-point"
    assert received.receiver.counts == {"lost_setpoints": 0, "refused_setpoints": 1}


def test_a_refused_set_point_has_arrived_and_does_not_count_as_lost(received: Received) -> None:
    assert received.send(1)["done"]
    assert not received.send(2, 0.1, 9.0, 0.1)["done"]
    assert not received.send(3, 0.1)["done"]
    assert received.send(4)["done"]
    assert received.receiver.counts == {"lost_setpoints": 0, "refused_setpoints": 2}


def test_a_refused_number_may_be_sent_again(received: Received) -> None:
    assert not received.send(2, 0.1, 9.0, 0.1)["done"]
    assert received.send(2)["done"]


def test_the_number_of_lost_set_points_fits_an_archive_whatever_is_sent(received: Received) -> None:
    for connection in range(1, 2000):
        received.send(0, connection=connection)
        received.send(LARGEST, connection=connection)
        received.receiver.disconnected(connection)
    assert received.receiver.counts["lost_setpoints"] <= 2**63 - 1
