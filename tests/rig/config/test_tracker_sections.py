"""Trackers in the rig file: bad values and combinations have one clear message each."""

from __future__ import annotations

import pytest

from protocols import BadInputError
from rig.config import loader


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("driver: mock, rate_hz: 100", "driver: moc, rate_hz: 100", "one of udp, mock"),
        ("delay_ms: 2,", "delay_ms: 300,", "more than delay_ms, 300 ms"),
        ("rate_hz: 100, delay", "rate_hz: 1, delay", "at least two poses of tracker 'pose', 2 s"),
        ("  pose: {driver: mock", "  other: {driver: mock}\n  pose: {driver: mock", "one tracker at most"),
    ],
)
def test_a_fault_of_a_tracker_has_a_clear_message(old: str, new: str, expected: str) -> None:
    text = loader.text("mock-tracker")
    assert text.count(old) == 1
    with pytest.raises(BadInputError) as bad:
        loader.parse(text.replace(old, new), "rig.yaml")
    assert any(expected in problem.expected for problem in bad.value.problems), bad.value


def test_a_rig_has_cameras_or_a_tracker() -> None:
    with pytest.raises(BadInputError) as bad:
        loader.parse(loader.text("mock") + "trackers: {pose: {driver: mock}}\n", "rig.yaml")
    (problem,) = bad.value.problems
    assert "one or the other measures the tip" in problem.expected
    assert problem.line > 0
