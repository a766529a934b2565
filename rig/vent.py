"""Venting a rig from outside, whatever its run is doing."""

from __future__ import annotations

import os
import signal
import time

from rig.bench import Bench, open_bench
from rig.config import RigConfig
from rig.daq.base import CardBusyError

REPEATED_S = 0.25
PAUSE_S = 0.002
PATIENCE_S = 0.05
"""A watchdog that is making the card safe has it for a moment only."""
FREED_S = 2.0


def vent(config: RigConfig) -> None:
    """Write the vented state to every card, again and again for a while: longer than any control period.

    A run that goes finds its valves where it did not put them, and ends. One that has just looked writes once more,
    and is overwritten. Of a card that lets in one process at a time, the process that has it is killed.

    Raises:
        CardError: a card cannot be opened or written.
    """
    bench = _opened(config)
    try:
        until = time.monotonic() + REPEATED_S
        while time.monotonic() < until:
            bench.make_safe(vent=True)
            time.sleep(PAUSE_S)
        bench.make_safe(vent=True)
    finally:
        bench.close()


def _opened(config: RigConfig) -> Bench:
    began = time.monotonic()
    while True:
        try:
            return open_bench(config, watchdog=True)
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
