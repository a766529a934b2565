"""Other processes that open a card under test: one that writes it once, and one that holds it until it is killed."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rig.driver_contract.card_subject import CardSubject, Floats
from rig.driver_contract.check import BrokenContractError

START_S = 30.0


def _command(mode: str, subject: CardSubject, outputs: Floats) -> list[str]:
    words = ",".join(f"{v:.6f}" for v in outputs)
    return [
        sys.executable,
        "-P",
        "-m",
        "rig.driver_contract.card_holder",
        mode,
        str(subject.rig_file),
        subject.name,
        words,
    ]


def in_second_process(subject: CardSubject, outputs: Floats) -> dict[str, Any]:
    """What a second process gets that opens the card and writes."""
    try:
        done = subprocess.run(
            _command("write", subject, outputs), capture_output=True, text=True, timeout=START_S, check=False
        )
    except subprocess.TimeoutExpired:
        raise BrokenContractError(f"a second process that opens the card does not end within {START_S:g} s") from None
    try:
        return dict(json.loads(done.stdout))
    except ValueError:
        raise BrokenContractError(f"a second process failed: {done.stderr[-300:] or done.returncode}") from None


@contextmanager
def holding(subject: CardSubject, outputs: Floats) -> Iterator[subprocess.Popen[str]]:
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
