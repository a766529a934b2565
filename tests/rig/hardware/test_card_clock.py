"""The sampling clock of a card, in the record and in `rig show`."""

from __future__ import annotations

import os
from collections.abc import Iterator
from io import StringIO
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from rich.console import Console

import runs
import tests.support.synthetic_runs as made_up
from rig.cli.archive_output import summary_table
from rig.config.schema import RigConfig
from rig.hardware.bench import Bench
from rig.hardware.cards.base import Scans
from rig.realtime.shared_state import SharedState
from runs.archive.writer import finalise
from runs.records import RunFooter, Status
from runs.summary import summarise
from tests.support.plant_bench import mock_rig


class FakeCard:
    """A card that does nothing."""

    def start(self) -> None:
        """Sample nothing."""

    def read(self) -> Scans:
        return Scans(np.empty(0, np.int64), np.empty((0, 3)))

    def write(self, outputs: NDArray[np.float64]) -> None:
        """Drive nothing."""

    def readback(self) -> NDArray[np.float64]:
        return np.zeros(2)

    def close(self) -> None:
        """Release nothing."""


class ClockedCard(FakeCard):
    """One that samples by its own clock, or could."""

    def __init__(self, period_ns: float | None, drift_ppm: float | None) -> None:
        self.clock = None if period_ns is None else SimpleNamespace(period_ns=period_ns, drift_ppm=drift_ppm)


@pytest.fixture
def two_cards() -> RigConfig:
    return mock_rig(
        cards={
            name: {"driver": "mock", "device": name, "outputs": 2, "inputs": 8, "sampling_hz": 1000}
            for name in ("daq", "other")
        },
        valves__1__card="other",
    )


@pytest.fixture
def memory(two_cards: RigConfig) -> Iterator[SharedState]:
    memory = SharedState.create(two_cards)
    yield memory
    os.close(memory.fd)


def test_rounded_period_and_drift_are_reported_for_a_card_with_a_clock(
    two_cards: RigConfig, memory: SharedState
) -> None:
    bench = Bench(two_cards, {"daq": FakeCard(), "other": ClockedCard(999_900.0, -31.2504)})
    memory.publish_clocks(bench.clocks)
    assert memory.clock_counters(two_cards.cards) == {
        "other_scan_period_ns": 999_900,
        "other_scan_drift_ppb": -31_250,
    }


def test_a_card_read_by_instruction_reports_no_clock(two_cards: RigConfig, memory: SharedState) -> None:
    bench = Bench(two_cards, {"daq": FakeCard(), "other": ClockedCard(None, None)})
    memory.publish_clocks(bench.clocks)
    assert memory.clock_counters(two_cards.cards) == {}


def test_the_archive_keeps_the_clock_and_the_run_is_shown_with_it(tmp_path: Path) -> None:
    counters = {"daq_scan_period_ns": 999_900, "daq_scan_drift_ppb": 31_250}
    writer = made_up.write_journal(tmp_path / "run.mcap", duration_s=1.0, footer=False, pictures=0)
    writer.close(RunFooter(made_up.START_NS + 10**9, Status.FINISHED, "", counters))
    run = runs.open(finalise(writer.path))
    assert run.timing.counters == counters
    shown = StringIO()
    Console(file=shown, width=120, markup=False).print(summary_table(summarise(run), run.timing.counters))
    assert "card daq samples every [us]" in shown.getvalue()
    assert "999.900" in shown.getvalue()
    assert "+31.2" in shown.getvalue()
