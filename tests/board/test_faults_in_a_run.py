"""A fault of the board under a run that regulates the simulated chambers through it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.board.board_run import SHORT_S, BoardRun
from tests.board.monitor import Monitor
from tests.hardware.forked_run import wait_until


@pytest.fixture
def run(bench: Monitor, board: Monitor, kernels: None, tmp_path: Path) -> Iterator[BoardRun]:
    started = BoardRun(tmp_path / "run", bench)
    yield started
    started.end()


def test_a_run_drives_the_valves_again_after_a_reset_of_the_board(run: BoardRun, bench: Monitor) -> None:
    before_ns = bench.get("outputs-changed-ns")
    bench.set("reset", value=True)
    wait_until(
        lambda: not run.safe() and bench.get("outputs-changed-ns") > before_ns, SHORT_S, "a valve is driven again"
    )
    assert run.process.poll() is None
