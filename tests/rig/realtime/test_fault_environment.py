"""No reader, clock or protocol can harm a run: non-blocking writer, calendar clock, pressure limit."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rig
import rig.config.loader
from rig.cli.nonblocking_writer import CLOSE_TIMEOUT_S, MOST_TEXTS, NonBlockingWriter
from rig.control import step as control
from rig.hardware.bench import Bench
from rig.simulator.plant import Plant
from scripts.faults.environment import DAY_NS, SteppedClock
from tests.support.budget import examples

ROOM = Path(rig.__file__).parent
CALENDAR = {("time", "time"), ("time", "time_ns"), ("datetime", "now"), ("datetime", "utcnow"), ("datetime", "today")}
MAY_ASK_THE_CALENDAR = {"realsense.py", "lock.py"}
"""RealSense's stamps are the calendar's: of one, only its age on arrival is taken. The message of a busy card says
since when it is held; nothing compares that time.
"""
RUNNING = [
    "realtime",
    "virtual",
    "hardware",
    "hardware/cards",
    "hardware/cameras",
    "control",
    "observation",
    "simulator",
    "arm_effects",
    "execution",
    "tip_control",
]
RUNNING_SCREEN = [f"cli/{name}.py" for name in ("terminal", "keyboard", "nonblocking_writer")]


def test_a_reader_that_stops_reading_does_not_block_the_writer() -> None:
    read_end, write_end = os.pipe()
    with os.fdopen(write_end, "w") as stream:
        outlet = NonBlockingWriter(stream)
        for _ in range(3 * MOST_TEXTS):
            outlet.write("x" * 1000)
        before = time.monotonic()
        outlet.close()
        assert time.monotonic() - before < CLOSE_TIMEOUT_S + 5
        os.close(read_end)


def test_a_reader_that_reads_gets_everything_in_order() -> None:
    read_end, write_end = os.pipe()
    with os.fdopen(write_end, "w") as stream:
        outlet = NonBlockingWriter(stream)
        for number in range(1000):
            outlet.write(f"{number}\n")
        outlet.close()
    with os.fdopen(read_end) as reader:
        assert reader.read().split() == [str(number) for number in range(1000)]


def test_a_reader_that_has_gone_is_not_an_error() -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    with os.fdopen(write_end, "w") as stream:
        outlet = NonBlockingWriter(stream)
        outlet.write("without a reader\n")
        outlet.close()


def test_no_running_code_reads_the_calendar_clock() -> None:
    """Only code that reads the calendar clock is affected by a step; the anchor of the record is read once."""
    modules = [path for room in RUNNING for path in (ROOM / room).glob("*.py")]
    assert len(modules) > 50
    for path in (*modules, *(ROOM / name for name in RUNNING_SCREEN)):
        if path.name in MAY_ASK_THE_CALENDAR:
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                assert (node.value.id, node.attr) not in CALENDAR, f"{path}:{node.lineno}"


@examples(12)
@given(st.floats(0.8, 100.0), st.floats(0.0, 1000.0), st.integers(0, 2**31))
def test_no_set_point_whatever_can_raise_a_chamber_above_the_limit(bar: float, bar_per_s: float, seed: int) -> None:
    """The preflight check refuses such set-points; this test bypasses it."""
    config = rig.config.loader.load("mock")
    plant = Plant(config, seed, 0, moving_arm=False)
    bench = Bench(config, {"daq": plant.card("daq")})
    prepared = control.prepare(config)
    state = control.initial(prepared)
    bench.safe_state.arm()
    bench.start()
    setpoint, rate = np.full(3, bar * 1e5), np.full(3, bar_per_s * 1e5)
    highest, trip = 0.0, None
    for t_ns in range(10_000_000, 3_000_000_000, 5_000_000):
        plant.advance(t_ns)
        scans = bench.read()
        sample = control.Sample(t_ns, int(scans.t_ns[-1]), scans.signals[-1], scans.pressure_pa.mean(axis=0))
        state, command = control.step(prepared, state, sample, setpoint, rate)
        if command.trip is None:
            bench.write(command.outputs)
        highest = max(highest, float(plant.pressure_pa.max()))
        if command.trip is not None:
            trip = command.trip
            bench.safe_state.make_safe()
    limit_pa = (config.limits.pressure_bar + config.limits.pressure_margin_bar) * 1e5
    assert trip is not None
    # Beyond it the air goes on for the sensor's lag, one cycle and the spool: 20 ms at the fastest rate allowed.
    assert highest < limit_pa + 0.05e5
    assert np.all(plant.pressure_pa < 0.05e5)


@pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="the clock that steps takes a C compiler")
def test_the_campaign_steps_the_calendar_clock_of_a_running_process_and_not_the_monotonic_one(
    tmp_path: Path,
) -> None:
    clock = SteppedClock(tmp_path)
    program = (
        "import datetime, sys, time\n"
        "for _ in sys.stdin:\n"
        "    print(time.time_ns(), datetime.datetime.now().timestamp() * 1e9, time.monotonic_ns(), flush=True)\n"
    )

    def told(process: subprocess.Popen[str]) -> list[float]:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write("\n")
        process.stdin.flush()
        return [float(word) for word in process.stdout.readline().split()]

    with subprocess.Popen(
        [sys.executable, "-c", program],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | clock.environment,
    ) as process:
        before = told(process)
        clock.require([process.pid])
        for days in (1, -1):
            clock.step(days * DAY_NS)
            calendar, date, monotonic = told(process)
            assert calendar - time.time_ns() == pytest.approx(days * DAY_NS, abs=60e9)
            assert date - time.time_ns() == pytest.approx(days * DAY_NS, abs=60e9)
            assert 0 < monotonic - before[2] < 60e9
        with pytest.raises(RuntimeError, match="does not have the clock"):
            clock.require([os.getpid()])
