"""The camera trigger: one pulse per frame period at whole control cycles, never two closer than that."""

from __future__ import annotations

from collections.abc import Iterable

from rig.control.trigger import TriggerPulses
from tests.support.triggered_bench import FRAME_NS, triggered_rig

PERIOD_NS = 5_000_000
CYCLES = 8


class Output:
    """A digital output, and a clock that each write takes 20 us of."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.edges: list[tuple[int, bool]] = []

    def write_trigger(self, *, high: bool) -> None:
        """Set the level."""
        self.edges.append((self.now_ns, high))
        self.now_ns += 20_000

    def clock(self) -> int:
        """The time."""
        return self.now_ns


def played(cycles: Iterable[int], pulses: TriggerPulses, output: Output, start_ns: int = 0) -> list[tuple[int, ...]]:
    """Number, time and skipped periods of the pulses in these cycles."""
    rows = []
    for cycle in cycles:
        output.now_ns = start_ns + cycle * PERIOD_NS
        if (row := pulses.cycle(cycle)) is not None:
            rows.append((int(row["pulse"]), int(row["t_ns"]), int(row["skipped"])))
    return rows


def test_pulses_have_the_frame_period_and_the_stated_width() -> None:
    for width_ms, key in ((5, ""), (15, ", width_ms: 15")):
        output = Output()
        pulses = TriggerPulses(triggered_rig(trigger=key), output, output.clock)
        rows = played(range(24), pulses, output)
        # The edge is between the times before and after the write, which takes 20 us.
        assert rows == [(k, k * FRAME_NS + 10_000, 0) for k in range(3)]
        widths = [low - high for (high, _), (low, _) in zip(output.edges[::2], output.edges[1::2], strict=False)]
        assert widths[:2] == [width_ms * 1_000_000] * 2


def test_a_pulse_of_a_missed_cycle_begins_late_and_none_follows_it_too_soon() -> None:
    output = Output()
    pulses = TriggerPulses(triggered_rig(), output, output.clock)
    cycles = [*range(CYCLES), *range(CYCLES + 3, 40)]
    rows = played(cycles, pulses, output)
    assert [t_ns // PERIOD_NS for _, t_ns, _ in rows] == [0, 11, 19, 27, 35]
    assert not any(skipped for _, _, skipped in rows)


def test_a_pulse_after_a_write_that_took_long_is_not_too_early() -> None:
    output = Output()
    pulses = TriggerPulses(triggered_rig(), output, output.clock)
    output.now_ns = 30_000_000
    pulses.cycle(0)
    ((_, t_ns, _),) = played(range(7, 18), pulses, output)
    assert t_ns - 30_000_000 >= FRAME_NS - PERIOD_NS


def test_frame_periods_without_a_pulse_are_counted() -> None:
    output = Output()
    pulses = TriggerPulses(triggered_rig(), output, output.clock)
    rows = played([*range(3), *range(26, 40)], pulses, output)
    assert [skipped for _, _, skipped in rows] == [0, 2, 0]
    assert [number for number, _, _ in rows] == [0, 1, 2], "a pulse that was left out has no number"


def test_a_run_begins_two_frame_periods_after_the_last_pulse_before_it() -> None:
    output = Output()
    pulses = TriggerPulses(triggered_rig(), output, output.clock)
    played(range(CYCLES + 1), pulses, output)
    pulses.restart()
    start_ns = 10 * PERIOD_NS
    ((number, t_ns, skipped),) = played(range(20), pulses, output, start_ns)
    assert (number, skipped) == (2, 0)
    assert 0 <= t_ns - (CYCLES * PERIOD_NS + 2 * FRAME_NS) < 2 * PERIOD_NS
    assert output.edges[3] == (start_ns, False), "the output that is high at the restart goes low first"
