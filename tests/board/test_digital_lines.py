"""Camera trigger and contacts on the digital lines of the emulated board, by its real driver."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from rig.config.loader import load
from rig.control.trigger import TriggerPulses
from rig.hardware.bench import Bench, open_bench
from rig.hardware.cards.comedi import ComediCard
from tests.board.board_run import rig_text
from tests.board.conftest import CARD
from tests.board.monitor import Monitor
from tests.support.card_setups import comedi_setup

RESULTS = Path("/out/digital_lines.json")
CHANNEL = 3
CYCLES, CYCLE_S = 210, 0.005
"""Control cycles of the trigger: 27 frame periods at 25 Hz."""
TRIGGER = f"exposure_ms: 8\n    rate_hz: 25\n    trigger: {{card: daq, channel: {CHANNEL}, width_ms: 20}}"
HALF_A_CYCLE_NS = 2.5e6


def with_lines(text: str) -> str:
    """The rig file with the digital lines of the card."""
    card = "inputs: 16, outputs: 2}"
    assert card in text
    return text.replace(card, "inputs: 16, outputs: 2, digital_inputs: 16, digital_outputs: 16}")


@pytest.fixture
def triggered(board: Monitor, tmp_path: Path) -> Iterator[tuple[Bench, TriggerPulses]]:
    """The open cards of a rig with a triggered camera, and its pulses."""
    text, size = with_lines(rig_text("pci1716")), "height_px: 480"
    assert size in text
    path = tmp_path / "triggered.yaml"
    path.write_text(text.replace(size, f"{size}\n    {TRIGGER}"))
    config = load(str(path))
    bench = open_bench(config)
    bench.safe_state.arm()
    yield bench, TriggerPulses(config, bench, time.monotonic_ns)
    bench.close()


def test_the_trigger_pulses_are_at_the_board_when_their_rows_say(
    triggered: tuple[Bench, TriggerPulses], board: Monitor
) -> None:
    bench, pulses = triggered
    before_ns = board.get("digital-written-ns")
    rows, began = [], time.monotonic()
    for number in range(CYCLES):
        time.sleep(max(0.0, began + number * CYCLE_S - time.monotonic()))
        if (row := pulses.cycle(number)) is not None:
            rows.append((int(row["t_ns"]), float(row["write_s"]) * 1e9))
    bench.safe_state.make_safe()
    levels = [(value >> CHANNEL & 1, t_ns) for value, t_ns in board.digital_writes(before_ns)]
    rises = np.array([t_ns for k, (high, t_ns) in enumerate(levels) if high and not (k and levels[k - 1][0])], float)
    stamped, width_ns = np.array(rows, float).T
    assert levels[-1][0] == 0, "the safe state sets the trigger low"
    assert len(stamped) >= 20
    assert len(rises) == len(stamped)
    # The kernel derives CLOCK_MONOTONIC from another clock than the board's: one offset, and one ratio of both.
    start = stamped[0]
    off_ns = rises - np.polyval(np.polyfit(stamped - start, rises, 1), stamped - start)
    figures = {
        "pulses": len(stamped),
        "largest distance of a stamp from the edge [us]": round(float(np.abs(off_ns).max()) * 1e-3, 2),
        "half of the time of the write, median [us]": round(float(np.median(width_ns)) * 0.5e-3, 2),
    }
    RESULTS.write_text(json.dumps(figures) + "\n")
    print(figures)
    assert (np.abs(off_ns) <= width_ns / 2).all()
    falls = np.array([t_ns for k, (high, t_ns) in enumerate(levels) if not high and k and levels[k - 1][0]], float)
    high_ns = falls[: len(rises) - 1] - rises[: len(falls)][: len(rises) - 1]
    assert np.median(high_ns) == pytest.approx(20e6, abs=HALF_A_CYCLE_NS)


def test_each_contact_reads_high_while_it_is_closed(board: Monitor) -> None:
    card = ComediCard(comedi_setup(CARD, digital_inputs=(0, 5, 15)))
    try:
        for closed, expected in ((0, [0, 0, 0]), (1 << 5, [0, 1, 0]), (1 << 15 | 1, [1, 0, 1])):
            board.set("contacts", closed)
            assert card.read_digital().tolist() == [bool(one) for one in expected]
    finally:
        card.close()
