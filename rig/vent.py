"""Venting a rig from outside, whatever its run is doing."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Iterator

from rig.bench import Bench, cards_with_valves, open_outputs
from rig.config import RigConfig
from rig.daq.base import CardBusyError, CardError
from rig.lock import holders

REPEATED_S = 0.25
NOTICED_S = 0.1
"""A run that goes finds its valves moved at its next tick, and says so; who has not by then is told."""
PAUSE_S = 0.002
PATIENCE_S = 0.05
"""A watchdog that is making the card safe has it for a moment only."""
FREED_S = 2.0


def vent(config: RigConfig) -> None:
    """Write the vented state to every card, again and again for a while: longer than any control period.

    A run that goes finds its valves where it did not put them, and ends. One that has just looked writes once more,
    and is overwritten. One that has not begun, that stands still, or whose valves stand there anyway, is told to end
    (SIGTERM). Of a card that lets in one process at a time, the process that has it is killed.

    Raises:
        CardError: a card cannot be opened or written, or an output does not stay where it was told to; the others
            are vented all the same.
    """
    benches: list[Bench] = []
    failures: list[str] = []
    for card in cards_with_valves(config):
        # A card that is gone keeps no other from being vented.
        with _noting(failures):
            benches.append(_opened(config, card))
        _insist(benches[-1:], 0.0)
    try:
        _insist(benches, NOTICED_S)
        for holder in holders(config):
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(holder, signal.SIGTERM)
        _insist(benches, REPEATED_S - NOTICED_S)
        for bench in benches:
            with _noting(failures):
                bench.arm(vent=True)
    finally:
        for bench in benches:
            bench.close()
    if failures:
        raise CardError("; ".join(failures))


def _insist(benches: list[Bench], seconds: float) -> None:
    until = time.monotonic() + seconds
    while True:
        for bench in benches:
            with contextlib.suppress(CardError):  # the last write tells
                bench.make_safe(vent=True)
        if time.monotonic() >= until:
            return
        time.sleep(PAUSE_S)


@contextlib.contextmanager
def _noting(failures: list[str]) -> Iterator[None]:
    try:
        yield
    except CardError as error:
        failures.append(str(error))


def _opened(config: RigConfig, card: str) -> Bench:
    began = time.monotonic()
    while True:
        try:
            return open_outputs(config, card)
        except CardBusyError as busy:
            waited_s = time.monotonic() - began
            if not busy.holders or waited_s > FREED_S:
                raise
            for holder in busy.holders if waited_s > PATIENCE_S else ():
                try:
                    os.kill(holder, signal.SIGKILL)
                except ProcessLookupError:
                    continue
                except PermissionError:
                    raise busy from None
            time.sleep(PAUSE_S)
