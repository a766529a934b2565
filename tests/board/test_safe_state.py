"""Time to the safe state at the D/A registers of the emulated board, on the board's clock, after each kind of fault."""

from __future__ import annotations

import json
import os
import random
import signal
import statistics
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.board.board_run import BoardRun, DigitalMark
from tests.board.monitor import Monitor
from tests.hardware.forked_run import forked

TRIALS = int(os.environ.get("SOFTRIG_BOARD_TRIALS", "1"))
RESULTS = Path("/out/safe_after_ms.jsonl")
Strike = Callable[[BoardRun, DigitalMark], None]


def kill_control(run: BoardRun, mark: DigitalMark) -> None:
    mark.set()
    os.kill(run.members["control"], signal.SIGKILL)


def stop_control(run: BoardRun, mark: DigitalMark) -> None:
    mark.set()
    os.kill(run.members["control"], signal.SIGSTOP)


def kill_supervisor_and_control(run: BoardRun, mark: DigitalMark) -> None:
    mark.set()
    for name in ("supervisor", "control"):
        os.kill(run.members[name], signal.SIGKILL)


def vent(run: BoardRun, mark: DigitalMark) -> None:
    """`rig vent`, without the time to load the program."""
    mark.set()
    with forked(["rig", "vent", "--rig", run.rig_file]) as command:
        said, _ = command.communicate()
    assert command.returncode == 0, said.decode()
    assert "; the pressures " in said.decode()


def run_out_of_memory(run: BoardRun, mark: DigitalMark) -> None:
    """The kernel's killer of processes that take too much memory, called by SysRq; it chooses control."""
    Path(f"/proc/{run.members['control']}/oom_score_adj").write_text("1000")
    mark.set()
    Path("/proc/sysrq-trigger").write_text("f")


KINDS: dict[str, Strike] = {
    "control killed": kill_control,
    "control hung": stop_control,
    "supervisor and control killed": kill_supervisor_and_control,
    "rig vent": vent,
    "control ended by the out-of-memory killer": run_out_of_memory,
}


@pytest.fixture
def mark() -> Iterator[DigitalMark]:
    opened = DigitalMark()
    yield opened
    opened.close()


@pytest.mark.usefixtures("kernels")
@pytest.mark.parametrize("kind", KINDS)
def test_the_registers_reach_the_safe_state(bench: Monitor, mark: DigitalMark, tmp_path: Path, kind: str) -> None:
    times_ms = []
    for trial in range(TRIALS):
        run = BoardRun(tmp_path / str(trial), bench)
        try:
            time.sleep(random.Random(f"{kind} {trial}").uniform(0.0, 0.5))
            assert not run.safe(), "the fault must find a valve that is driven"
            KINDS[kind](run, mark)
            times_ms.append(run.safe_after_ms())
        finally:
            run.end()
        assert times_ms[-1] > 0
        with RESULTS.open("a") as file:
            print(json.dumps({kind: round(times_ms[-1], 2)}), file=file)
    print(f"{kind}: {len(times_ms)} trials, median {statistics.median(times_ms):.1f} ms, worst {max(times_ms):.1f} ms")
