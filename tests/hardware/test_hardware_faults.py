"""Who else has the kernel's card: another writer, a lock on its outputs, a stopped process; and its clock."""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import numpy as np
import pytest

import rig.config.loader
from rig.config.loader import load
from rig.hardware.bench import open_bench
from rig.hardware.cards.base import CardError
from rig.realtime.failsafe import force_safe_state
from rig.realtime.shared_state import SharedState
from tests.hardware.kernel_card import CARD, COUNT_V, OpenCard, bipolar
from tests.hardware.rig_of_the_machine import LOOPED, VALVES

COMEDI_LOCK = (ord("d") << 8) | 5
OUTPUTS = 1
"""The card's subdevice of analogue outputs."""
HOLD = (
    "import sys, time\nfrom rig.hardware.bench import open_bench\nfrom rig.config.loader import load\n"
    "bench = open_bench(load(sys.argv[1]))\nprint('held', flush=True)\ntime.sleep(300)\n"
)


@pytest.fixture
def memory() -> Iterator[SharedState]:
    memory = SharedState.create(load(LOOPED))
    yield memory
    os.close(memory.fd)


@pytest.fixture
def locked() -> Iterator[None]:
    """Another program has the outputs for itself; other processes may open the card, and write nothing."""
    node = os.open(CARD, os.O_RDWR)
    fcntl.ioctl(node, COMEDI_LOCK, OUTPUTS)
    yield
    os.close(node)


def test_a_foreign_write_to_the_card_is_detected_at_the_next_check(open_card: OpenCard) -> None:
    bench = open_bench(load(LOOPED))
    bench.write(np.array([1.0, 2.0, 3.0]))
    assert bench.external_write() == ""
    other = open_card((), bipolar(VALVES[1]))
    other.write(np.array([7.0]))
    assert "valve 2 reads back 7.000 V instead of the commanded 2.000 V" in bench.external_write()
    bench.close()


def test_the_failsafe_makes_the_card_safe_and_ends_its_holders(memory: SharedState, open_card: OpenCard) -> None:
    watching = open_card((), bipolar(*VALVES))
    watching.write(np.array([5.0, 5.0, 5.0]))
    with subprocess.Popen([sys.executable, "-c", HOLD, LOOPED], stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"held\n"
        os.kill(holder.pid, signal.SIGSTOP)
        memory.control_pid = holder.pid
        assert force_safe_state(load(LOOPED), memory) == ""
        assert holder.wait(20) == -signal.SIGKILL
    np.testing.assert_allclose(watching.readback(), [0.0, 0.0, 0.0], atol=COUNT_V)


def test_a_card_whose_outputs_another_program_locks_is_not_armed(locked: None, memory: SharedState) -> None:
    bench = open_bench(load(LOOPED))
    with pytest.raises(CardError, match="the safe state could not be written, shut the air off by hand"):
        bench.safe_state.arm()
    bench.close()
    assert "cannot be written" in force_safe_state(load(LOOPED), memory)


def test_the_period_of_the_cards_own_clock_reaches_the_record(memory: SharedState) -> None:
    text = rig.config.loader.text(LOOPED).replace(
        "acquisition: instruction", "acquisition: command, sampling_hz: 1234.567"
    )
    config = rig.config.loader.parse(text, "looped.yaml")
    bench = open_bench(config)
    bench.start()
    until = time.monotonic() + 5
    while time.monotonic() < until:
        bench.read()
        time.sleep(0.01)
    memory.publish_clocks(bench.clocks)
    bench.close()
    counters = memory.clock_counters(config.cards)
    assert counters["daq_scan_period_ns"] == 810_000
    assert abs(counters["daq_scan_drift_ppb"]) <= 1_000_000
