"""A fault of the board under a run that regulates the simulated chambers through it."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from rig.hardware.vent_verification import UNCONFIRMED
from tests.board.board_run import LONG_S, SHORT_S, BoardRun
from tests.board.conftest import reload_driver, samples_by_its_own_clock
from tests.board.monitor import Monitor
from tests.hardware.forked_run import forked, wait_until

CONFIRMED = "the valves are in their safe state; the pressures "
DRIVER = Path("/sys/bus/pci/drivers/adv_pci1710")
UNBOUND_RESETS = {"pci1716": True, "pci1711": False}[os.environ.get("SOFTRIG_BOARD", "pci1716")]
"""Linux-Comedi resets the board when it lets it go; the kernel's driver leaves the outputs."""

STALLED = ("control process hung", "machine may have stalled")
STORM_MS = 300
STUCK_S = 2.0


@pytest.fixture
def run(bench: Monitor, board: Monitor, kernels: None, tmp_path: Path) -> Iterator[BoardRun]:
    started = BoardRun(tmp_path / "run", bench)
    yield started
    started.end()


@pytest.fixture
def reload(board: Monitor) -> Iterator[None]:
    """The driver is loaded anew after the test: the kernel may have switched its interrupt off."""
    yield
    board.set("irq-stuck", value=False)
    reload_driver()


@pytest.fixture
def unbind() -> Iterator[Callable[[], None]]:
    """Take the board from its driver; it is given back after the test."""
    (address,) = (link.name for link in DRIVER.glob("0000:*"))

    def let_go() -> None:
        (DRIVER / "unbind").write_text(address)

    yield let_go
    with suppress(OSError):
        (DRIVER / "bind").write_text(address)


def ended(run: BoardRun) -> str:
    """What a run said that a fault has ended, with its archive left."""
    said = run.said()
    assert run.process.returncode == 1
    assert len(run.archive().pressure.protocol_s) > 0
    return said


def went_on_or_ended_safely(run: BoardRun, bench: Monitor) -> None:
    """The run drives its valve again, or has ended in the safe state with the reason."""
    before_ns = bench.get("outputs-changed-ns")
    wait_until(
        lambda: run.process.poll() is not None or (not run.safe() and bench.get("outputs-changed-ns") > before_ns),
        SHORT_S,
        "the run ends, or drives its valve again",
    )
    if run.process.poll() is not None:
        said = ended(run)
        assert any(reason in said for reason in ("no pressure sample", *STALLED))
        assert CONFIRMED in said
        assert run.safe()


def test_a_run_drives_the_valves_again_after_a_reset_of_the_board(run: BoardRun, bench: Monitor) -> None:
    before_ns = bench.get("outputs-changed-ns")
    bench.set("reset", value=True)
    wait_until(
        lambda: not run.safe() and bench.get("outputs-changed-ns") > before_ns, SHORT_S, "a valve is driven again"
    )
    assert run.process.poll() is None


def test_a_run_without_interrupts_ends_in_the_safe_state(run: BoardRun, bench: Monitor) -> None:
    if not samples_by_its_own_clock():
        pytest.skip("this build of the driver refuses every command: the run needs no interrupt")
    bench.set("irq-lost", value=True)
    said = ended(run)
    assert "no pressure sample" in said
    assert CONFIRMED in said
    assert run.safe()


def test_a_stuck_interrupt_ends_a_run_in_the_safe_state_or_lets_it_go_on(
    reload: None, run: BoardRun, bench: Monitor
) -> None:
    """The board's own interrupts still come between: the kernel may take long to switch such a line off."""
    bench.set("irq-stuck", value=True)
    time.sleep(STUCK_S)
    went_on_or_ended_safely(run, bench)


def test_a_storm_of_claimed_interrupts_ends_a_run_in_the_safe_state_or_lets_it_go_on(
    reload: None, run: BoardRun, bench: Monitor
) -> None:
    """The driver takes each as its own, so that the kernel never switches it off: nothing else runs until it ends."""
    bench.set("irq-storm-ms", STORM_MS)
    wait_until(lambda: bench.get("irq-storm-ms") == 0, LONG_S, "the storm ends")
    went_on_or_ended_safely(run, bench)


def test_a_run_whose_board_answers_all_ones_says_that_its_outputs_may_not_have_moved(
    run: BoardRun, bench: Monitor
) -> None:
    """No write arrives. The read-back comes from the memory of the driver: only a pressure can show it."""
    stood = bench.outputs_v
    bench.set("hung", value=True)
    said = ended(run)
    np.testing.assert_allclose(bench.outputs_v, stood, atol=1.0)
    assert not run.safe()
    assert UNCONFIRMED in said
    assert CONFIRMED not in said


def test_venting_a_board_that_answers_all_ones_fails(run: BoardRun, bench: Monitor) -> None:
    os.kill(run.members["control"], signal.SIGKILL)
    assert CONFIRMED in ended(run)
    bench.set("hung", value=True)
    with forked(["rig", "vent", "--rig", run.rig_file]) as command:
        said = command.communicate(timeout=LONG_S)[0].decode()
    print(said)
    assert command.returncode == 1
    assert UNCONFIRMED in said


def test_a_run_whose_driver_lets_the_board_go_ends_and_says_what_could_not_be_written(
    run: BoardRun, bench: Monitor, unbind: Callable[[], None]
) -> None:
    unbind()
    assert "the safe state could not be written, shut the air off by hand" in ended(run)
    if UNBOUND_RESETS:
        assert bench.outputs_v == [0.0, 0.0]
