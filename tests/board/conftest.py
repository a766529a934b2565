"""These tests drive an emulated board by its real driver: they run in the virtual machine of `make test-board` only."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from rig.hardware.cards.base import Channel
from rig.hardware.cards.comedi import ComediCard
from rig.hardware.cards.comedi_survey import survey
from tests.board.monitor import Monitor
from tests.hardware import forked_run
from tests.support.card_setups import comedi_setup

CARD = "/dev/comedi0"
OpenBoard = Callable[..., ComediCard]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip outside the virtual machine, where a real card may have valves on it."""
    for item in items:
        if Path(__file__).parent in item.path.parents and not os.environ.get("SOFTRIG_BOARD"):
            item.add_marker(pytest.mark.skip(reason="part of make test-board"))


@pytest.fixture(scope="session")
def monitor() -> Iterator[Monitor]:
    opened = Monitor()
    yield opened
    opened.close()


@pytest.fixture
def board(monitor: Monitor) -> Iterator[Monitor]:
    """The board without faults, its driver loaded anew after the test if the test had one."""
    yield monitor
    for fault in ("hung", "irq-lost", "irq-stuck"):
        monitor.set(fault, value=False)
    monitor.set("irq-storm-ms", 0)
    monitor.set("open-inputs", 0)
    monitor.set("contacts", 0)
    for channel in range(16):
        monitor.set(f"ai{channel}", 0.0)


@pytest.fixture(scope="session")
def kernels(tmp_path_factory: pytest.TempPathFactory) -> None:
    """What a run compiles is loaded before one is forked."""
    forked_run.load_kernels("mock-no-camera", tmp_path_factory.mktemp("kernels"))


@pytest.fixture
def bench(monitor: Monitor) -> Iterator[Monitor]:
    """The board with the simulator behind it."""
    monitor.set("coupled", value=True)
    yield monitor
    monitor.set("coupled", value=False)


@pytest.fixture
def open_board() -> Iterator[OpenBoard]:
    """Open the board; it is closed after the test."""
    cards: list[ComediCard] = []

    def open_(inputs: tuple[int, ...] = (), sampling_hz: float = 1000.0, acquisition: str = "auto") -> ComediCard:
        lines = tuple(Channel(number, -10.0, 10.0) for number in inputs)
        outputs = (Channel(0, 0.0, 10.0), Channel(1, 0.0, 10.0))
        card = ComediCard(comedi_setup(CARD, lines, outputs, sampling_hz=sampling_hz, acquisition=acquisition))
        cards.append(card)
        return card

    yield open_
    for card in cards:
        card.close()


def samples_by_its_own_clock() -> bool:
    """True where this build of the driver takes commands."""
    (found,) = survey()
    return found.inputs is not None and found.inputs.fastest_hz is not None


def reload_driver() -> None:
    """Unload the board's driver and load it again."""
    subprocess.run(["rmmod", "adv_pci1710"], check=True)
    subprocess.run(os.environ["SOFTRIG_BOARD_LOAD"].split(), check=True)
