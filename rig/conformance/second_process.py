"""A second process that opens a card for a check: it writes the card once, or holds it until it is killed.

`python -m rig.conformance.second_process hold|write RIG_FILE CARD V1,V2,.. DESCRIPTOR PARENT` sends one message: the
read-back, the process ids of a busy card, or the error.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from model.arrays import Array
from rig.config import loader
from rig.conformance.card_subject import CardSubject
from rig.conformance.check import NonconformityError
from rig.conformance.messages import Sender, end_with, message
from rig.hardware.cards.base import CardBusyError, CardError, card_setup, open_card

SETTLED_S = 0.02
"""Time for the read-back of a device on a bus."""
DRIVEN_S = 0.05
"""How long the second process drives the card before anything happens to it."""


def in_second_process(subject: CardSubject, outputs: Array) -> dict[str, Any]:
    """What a second process gets that opens the card and writes."""
    with _second_process("write", subject, outputs) as (_, answer):
        return answer


@contextmanager
def holding(subject: CardSubject, outputs: Array) -> Iterator[subprocess.Popen[bytes]]:
    """A process that has started the card and writes it all the time."""
    with _second_process("hold", subject, outputs) as (process, answer):
        if "stands" not in answer:
            raise NonconformityError(f"a process of its own cannot drive the card: {answer}")
        time.sleep(DRIVEN_S)
        yield process


@contextmanager
def _second_process(
    mode: str, subject: CardSubject, outputs: Array
) -> Iterator[tuple[subprocess.Popen[bytes], dict[str, Any]]]:
    """A second process and its message; killed at the end."""
    values = ",".join(f"{v:.6f}" for v in outputs)
    heard, sends = os.pipe()
    command = [sys.executable, "-P", "-m", __spec__.name, mode, str(subject.rig_file), subject.name, values]
    process = subprocess.Popen([*command, str(sends), str(os.getpid())], stdin=subprocess.DEVNULL, pass_fds=[sends])
    os.close(sends)
    try:
        with os.fdopen(heard, "rb") as answers:
            line = answers.readline()
        if not line:
            raise NonconformityError(f"a second process that opens the card ends with status {process.wait()}")
        yield process, message(line)
    finally:
        process.kill()
        process.wait()


def main(mode: str, rig_file: str, name: str, outputs: str, descriptor: str, parent: str) -> None:
    """Open the card; `hold`: start it, and write and read it until the process is killed."""
    end_with(int(parent))
    sender = Sender(int(descriptor))
    config = loader.load(rig_file)
    setup = card_setup(config, name)
    written = np.array([float(v) for v in outputs.split(",")])
    try:
        card = open_card(config.cards[name], setup if mode == "hold" else replace(setup, inputs=()))
        if mode == "hold":
            card.start()
        card.write(written)
        time.sleep(SETTLED_S if mode == "write" else 0.0)
        stands = card.readback().tolist()
    except CardBusyError as busy:
        sender.send(busy=busy.holders, message=str(busy))
        return
    except CardError as error:
        sender.send(error=str(error))
        return
    except (Exception, SystemExit) as error:  # the code of another package may raise anything
        sender.send(raised=f"{type(error).__name__}: {error}")
        return
    if mode == "write":
        card.close()
    sender.send(stands=stands)
    while mode == "hold":
        time.sleep(1 / config.control.rate_hz)
        card.read()
        card.write(written)


if __name__ == "__main__":
    main(*sys.argv[1:])
