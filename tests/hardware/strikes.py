"""What takes a while or takes the card away. Not part of `make test-hardware`; `make strikes` runs it."""

from __future__ import annotations

import fcntl
import os
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from rig.config.loader import load
from runs.records import Status
from tests.hardware.forked_run import wait_until
from tests.hardware.kernel_card import CARD, OpenCard
from tests.hardware.rig_of_the_machine import LOOPED, Player
from tests.hardware.struck_run import SHORT_S, Struck

COMEDI_DEVCONFIG = (1 << 30) | (148 << 16) | (ord("d") << 8)
"""_IOW('d', 0, struct comedi_devconfig): a name of 20 bytes and 32 numbers; without any, the device is detached."""


def test_pictures_that_end(struck: Struck, player: Player, timed: Callable[[float], None]) -> None:
    struck_ns = time.monotonic_ns()
    player.process.kill()
    timed(struck.until_safe_ms(struck_ns))
    assert f"gave no picture within {load(LOOPED).limits.no_tip_s:g} s" in struck.said()
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
