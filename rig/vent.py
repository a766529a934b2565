"""Venting a rig from outside, whatever its run is doing."""

from __future__ import annotations

import time

from rig.bench import open_bench
from rig.config import RigConfig

REPEATED_S = 0.25
PAUSE_S = 0.002


def vent(config: RigConfig) -> None:
    """Write the vented state to every card, again and again for a while: longer than any control period.

    A run that goes finds its valves where it did not put them, and ends. One that has just looked writes once more,
    and is overwritten.

    Raises:
        CardError: a card cannot be opened or written.
    """
    bench = open_bench(config, watchdog=True)
    try:
        until = time.monotonic() + REPEATED_S
        while time.monotonic() < until:
            bench.make_safe(vent=True)
            time.sleep(PAUSE_S)
        bench.make_safe(vent=True)
    finally:
        bench.close()
