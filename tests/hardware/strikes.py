"""Runs on the kernel's devices that are struck: what the valves see, who says what, and what is left of the record.

The valves' voltages are what another process reads back through the card's inputs, by its own handle. Not part of
`make test-hardware`, whose guest may be too slow to look at a picture in time; `make strikes` runs it.
"""

from __future__ import annotations

import fcntl
import json
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import forked_run
import numpy as np
import pytest
from forked_run import members, wait_until
from kernel_card import CARD, COUNT_V, OpenCard, bipolar
from numpy.typing import NDArray
from rig_of_the_machine import LOOPED, VALVES, Player

import runs
from rig.cameras.base import Frame, Shot
from rig.observer import Observer
from rig.rig_file import load
from runs.records import Status
from runs.recovery import Fate, recover
from runs.run import Run

COMEDI_DEVCONFIG = (1 << 30) | (148 << 16) | (ord("d") << 8)
"""_IOW('d', 0, struct comedi_devconfig): a name of 20 bytes and 32 numbers; without any, the device is detached."""
MOVING_V = 0.5
NO_TIP_S = 15
LONG_S, SHORT_S = 400.0, 120.0


Inputs = Callable[[], NDArray[np.float64]]
"""Reads the inputs of the valves [V]."""


class Struck:
    """A run that has moved a valve, and the valves as they are seen from outside it."""

    def __init__(self, out: Path, inputs: Inputs, rig_file: Path) -> None:
        self.out = out
        self.inputs = inputs
        self.process = forked_run.run(rig_file, out)
        try:
            wait_until(lambda: self.over() or bool(inputs().max() > MOVING_V), LONG_S, "a valve moves")
            assert not self.over(), self.said()
        except BaseException:
            self.end()
            raise
        self.members = members(self.process.pid)

    def over(self) -> bool:
        return self.process.poll() is not None

    def strike(self, number: signal.Signals, *names: str) -> int:
        """Send members a signal, one right after the other; when [ns]."""
        struck_ns = time.monotonic_ns()
        for name in names:
            os.kill(self.members[name], number)
        return struck_ns

    def until_safe_ms(self, struck_ns: int) -> float:
        """How long it took until every valve was seen at its safe voltage."""
        wait_until(lambda: bool(np.abs(self.inputs()).max() < 2 * COUNT_V), SHORT_S, "the valves are safe")
        return (time.monotonic_ns() - struck_ns) * 1e-6

    def said(self) -> str:
        """Everything that was printed, once the run is over; printed again, to be seen where a test fails."""
        said = self.process.communicate(timeout=SHORT_S)[0].decode(errors="replace")
        print(said)
        return said

    def archive(self) -> Run:
        """The one archive that is left."""
        (path,) = self.out.glob("*.h5")
        return runs.open(path)

    def recovered(self) -> Run:
        """What is made of the journal that a killed conductor left, when no process of the run is left."""
        wait_until(lambda: not any(map(_runs, self.members.values())), SHORT_S, "the others end")
        (outcome,) = recover(self.out)
        assert outcome.fate is Fate.RECOVERED, outcome.message
        return self.archive()

    def end(self) -> None:
        for pid in members(self.process.pid).values():
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                continue
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()


def _runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.fixture(scope="module", autouse=True)
def compiled() -> None:
    """What is compiled at its first use is there before a run is forked."""
    observer = Observer(load(LOOPED))
    with np.load(os.environ["SOFTRIG_PICTURES"]) as stored:
        image = stored["pictures"][0]
    observer.step(Shot.of(Frame(0, 1, image)), np.array([1]), np.zeros((1, 3)), 0.0, 0)


@pytest.fixture
def inputs(open_card: OpenCard) -> Inputs:
    card = open_card(bipolar(*VALVES), (), acquisition="instruction")
    card.start()
    return lambda: card.read().volts[-1]


@pytest.fixture
def struck(tmp_path: Path, player: Player, inputs: Inputs) -> Iterator[Struck]:
    rig_file = tmp_path / "looped.yaml"
    rig_file.write_text(Path(LOOPED).read_text().replace("no_tip_s: 30", f"no_tip_s: {NO_TIP_S}"))
    run = Struck(tmp_path / "out", inputs, rig_file)
    yield run
    run.end()


@pytest.fixture
def timed(out: Path, request: pytest.FixtureRequest) -> Callable[[float], None]:
    """Leave a time for the host: it is recorded and not judged, because the machine is emulated."""

    def note(milliseconds: float) -> None:
        with (out / "safe_after_ms.jsonl").open("a") as file:
            print(json.dumps({request.node.name: round(milliseconds, 1)}), file=file)

    return note


def test_ctrl_c(struck: Struck, timed: Callable[[float], None]) -> None:
    timed(struck.until_safe_ms(struck.strike(signal.SIGINT, "conductor")))
    assert "by the operator (Ctrl-C)" in struck.said()
    assert struck.process.returncode == 130
    assert struck.archive().status is Status.INTERRUPTED


def test_the_conductor_killed(struck: Struck, timed: Callable[[float], None]) -> None:
    timed(struck.until_safe_ms(struck.strike(signal.SIGKILL, "conductor")))
    assert struck.process.wait(SHORT_S) == -signal.SIGKILL
    assert struck.recovered().status is not Status.FINISHED


def test_control_killed(struck: Struck, timed: Callable[[float], None]) -> None:
    timed(struck.until_safe_ms(struck.strike(signal.SIGKILL, "control")))
    assert "the control process died" in struck.said()
    assert struck.process.returncode == 1
    run = struck.archive()
    assert (run.status, run.message) == (Status.ABORTED, "the control process died")
    assert run.pressure.measured_bar[:, 0].max() * 10 > MOVING_V


def test_the_observer_killed(struck: Struck, timed: Callable[[float], None]) -> None:
    timed(struck.until_safe_ms(struck.strike(signal.SIGKILL, "observing")))
    assert "the observer process died (exit status -9)" in struck.said()
    assert struck.process.returncode == 1
    assert struck.archive().status is Status.ABORTED


def test_conductor_and_control_killed_together(struck: Struck, timed: Callable[[float], None]) -> None:
    timed(struck.until_safe_ms(struck.strike(signal.SIGKILL, "conductor", "control")))
    assert struck.process.wait(SHORT_S) == -signal.SIGKILL
    assert struck.recovered().pressure.measured_bar[:, 0].max() * 10 > MOVING_V


def test_pictures_that_stand_still_for_a_second_then_a_driver_that_is_unloaded_then_sigterm(
    struck: Struck, player: Player, timed: Callable[[float], None]
) -> None:
    player.process.send_signal(signal.SIGSTOP)
    time.sleep(1.0)
    player.process.send_signal(signal.SIGCONT)
    refused = subprocess.run(["modprobe", "-r", "comedi_test"], capture_output=True, text=True, check=False)
    assert refused.returncode != 0
    assert "in use" in refused.stderr
    time.sleep(1.0)
    assert not struck.over(), struck.said()
    timed(struck.until_safe_ms(struck.strike(signal.SIGTERM, "conductor")))
    assert "SIGTERM" in struck.said()
    assert struck.process.returncode == 130
    assert struck.archive().status is Status.INTERRUPTED


def test_pictures_that_end(struck: Struck, player: Player, timed: Callable[[float], None]) -> None:
    struck_ns = time.monotonic_ns()
    player.process.kill()
    timed(struck.until_safe_ms(struck_ns))
    assert f"gave no picture within {NO_TIP_S} s" in struck.said()
    assert struck.process.returncode == 1
    assert struck.archive().status is Status.ABORTED


@pytest.fixture
def detachable() -> Iterator[None]:
    """The card is there again afterwards."""
    yield
    subprocess.run(["modprobe", "-r", "comedi_test"], check=True)
    subprocess.run(["modprobe", "comedi_test"], check=True)
    wait_until(Path(CARD).exists, SHORT_S, "the card is back")


def test_a_card_that_is_detached(detachable: None, open_card: OpenCard, struck: Struck) -> None:
    node = os.open(CARD, os.O_RDWR)
    try:
        fcntl.ioctl(node, COMEDI_DEVCONFIG, 0)
    finally:
        os.close(node)
    struck.said()
    assert struck.process.returncode == 1
    run = struck.archive()
    assert run.status is Status.ABORTED
    assert "shut the air off by hand" in run.message
