"""These tests drive the devices of a real kernel: they run in the virtual machine of `make test-hardware` only."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from rig.config.loader import load
from rig.hardware.cameras.base import Frame, FrameSet
from rig.hardware.cards.base import Channel
from rig.hardware.cards.comedi import ComediCard
from rig.observation.observer import Observer
from tests.hardware.kernel_card import CARD, OpenCard, bipolar
from tests.hardware.rig_of_the_machine import CAMERA, LOOPED, VALVES, Player
from tests.hardware.struck_run import Inputs, Struck
from tests.support.card_setups import comedi_setup
from tests.support.control_cycles import control_cycles


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip outside the virtual machine, where a real card may have valves on it; the archive is the host's."""
    for item in items:
        if Path(__file__).parent not in item.path.parents:
            continue
        on_host = item.path.stem == "test_hardware_archive"
        if not os.environ.get("SOFTRIG_GUEST_LEFT" if on_host else "SOFTRIG_GUEST"):
            item.add_marker(pytest.mark.skip(reason="part of make test-hardware"))


@pytest.fixture
def out() -> Path:
    """Where the host finds what the guest leaves."""
    return Path(os.environ["SOFTRIG_GUEST_OUT"])


@pytest.fixture
def open_card() -> Iterator[OpenCard]:
    """Open cards that are closed after the test."""
    cards: list[ComediCard] = []

    def open_(
        inputs: tuple[Channel, ...] = (),
        outputs: tuple[Channel, ...] = (),
        *,
        device: str = CARD,
        acquisition: str = "auto",
        sampling_hz: float = 1000.0,
    ) -> ComediCard:
        card = ComediCard(comedi_setup(device, inputs, outputs, sampling_hz=sampling_hz, acquisition=acquisition))
        cards.append(card)
        return card

    yield open_
    for card in cards:
        card.close()


@pytest.fixture
def player() -> Iterator[Player]:
    """The rendered scene, played into the kernel's loopback camera while the test runs."""
    pictures = os.environ["SOFTRIG_PICTURES"]
    program = Path(__file__).with_name("played_pictures.py")
    process = subprocess.Popen([sys.executable, program, "play", pictures, CAMERA], stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"playing\n"
    with np.load(pictures) as stored:
        tips = stored["tips"]
    yield Player(tips, process)
    process.kill()
    process.wait()
    process.stdout.close()


@pytest.fixture(scope="session")
def compiled() -> None:
    """What is compiled at its first use is there before a run is forked."""
    observer = Observer(load(LOOPED))
    with np.load(os.environ["SOFTRIG_PICTURES"]) as stored:
        image = stored["pictures"][0]
    observer.step(FrameSet.of(Frame(0, 1, image)), control_cycles([1], np.zeros((1, 3))), 0.0)


@pytest.fixture
def inputs(open_card: OpenCard) -> Inputs:
    card = open_card(bipolar(*VALVES), (), acquisition="instruction")
    card.start()
    return lambda: card.read().signals[-1]


@pytest.fixture
def struck(tmp_path: Path, compiled: None, player: Player, inputs: Inputs) -> Iterator[Struck]:
    run = Struck(tmp_path / "out", inputs)
    yield run
    run.end()


@pytest.fixture
def timed(out: Path, request: pytest.FixtureRequest) -> Callable[[float], None]:
    """Leave a time for the host: it is recorded and not judged, because the machine is emulated."""

    def note(milliseconds: float) -> None:
        with (out / "safe_after_ms.jsonl").open("a") as file:
            print(json.dumps({request.node.name: round(milliseconds, 1)}), file=file)

    return note
