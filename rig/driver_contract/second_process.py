"""A second process that opens a card for the contract test: it writes the card once, or holds it until it is killed.

`python -m rig.driver_contract.second_process hold|write RIG_FILE CARD V1,V2,..` prints one line of JSON: the read-back,
the process ids of a busy card, or the error.
"""

from __future__ import annotations

import json
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
from rig.driver_contract.card_subject import CardSubject
from rig.driver_contract.check import BrokenContractError
from rig.hardware.cards.base import CardBusyError, CardError, card_setup, open_card

START_S = 30.0
SETTLED_S = 0.02
"""Time for the read-back of a device on a bus."""


def in_second_process(subject: CardSubject, outputs: Array) -> dict[str, Any]:
    """What a second process gets that opens the card and writes."""
    command = _command("write", subject, outputs)
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=START_S, check=False)
    except subprocess.TimeoutExpired:
        raise BrokenContractError(f"a second process that opens the card does not end within {START_S:g} s") from None
    try:
        return dict(json.loads(done.stdout))
    except ValueError:
        raise BrokenContractError(f"a second process failed: {done.stderr[-300:] or done.returncode}") from None


@contextmanager
def holding(subject: CardSubject, outputs: Array) -> Iterator[subprocess.Popen[str]]:
    """A process that has started the card and writes it all the time."""
    process = subprocess.Popen(_command("hold", subject, outputs), stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        answer = json.loads(process.stdout.readline() or "{}")
        if "stands" not in answer:
            raise BrokenContractError(f"a process of its own cannot drive the card: {answer}")
        time.sleep(0.05)
        yield process
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def _command(mode: str, subject: CardSubject, outputs: Array) -> list[str]:
    words = ",".join(f"{v:.6f}" for v in outputs)
    module = "rig.driver_contract.second_process"
    return [sys.executable, "-P", "-m", module, mode, str(subject.rig_file), subject.name, words]


def main(mode: str, rig_file: str, name: str, outputs: str) -> None:
    """Open the card; `hold`: start it, and write and read it until the process is killed."""
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
        _tell(busy=busy.holders, message=str(busy))
        return
    except CardError as error:
        _tell(error=str(error))
        return
    except Exception as error:  # the code of another package may raise anything
        _tell(raised=f"{type(error).__name__}: {error}")
        return
    _tell(stands=stands)
    while mode == "hold":
        time.sleep(1 / config.control.rate_hz)
        card.read()
        card.write(written)
    card.close()


def _tell(**words: object) -> None:
    print(json.dumps(words), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
