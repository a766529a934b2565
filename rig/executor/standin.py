"""The safe state written by whoever is left, when control and the watchdog, whose duty it is, no longer can."""

from __future__ import annotations

import contextlib
import os
import signal
import time

from rig.bench import open_bench
from rig.config import RigConfig
from rig.daq.base import CardError
from rig.executor.memory import RunMemory, Stage, Stop

SILENT_NS = 200_000_000
"""Control and watchdog give a sign of life every few milliseconds; who is silent for so long does not act."""


CONDUCTOR_SILENT_NS = 500_000_000
OUTLIVE_S = 0.5
"""What the others get to make the bench safe before the observer does."""


FREED_S = 0.5


def made_safe(memory: RunMemory) -> bool:
    """True once control or the watchdog has written the safe state, or has said why it cannot."""
    ended = (Stage.DONE, Stage.FAILED)
    return any(memory.stage(name) in ended for name in ("control", "watchdog")) or bool(memory.get("fired_ns"))


def nobody_acts(memory: RunMemory) -> bool:
    """True while neither control nor the watchdog gives a sign of life."""
    now = time.monotonic_ns()
    return all(now - memory.heartbeat_ns(name) > SILENT_NS for name in ("control", "watchdog"))


def forsaken(memory: RunMemory) -> bool:
    """True while those who would make the bench safe stand still, all three of them."""
    conductor_ns = time.monotonic_ns() - memory.heartbeat_ns("conductor")
    return conductor_ns > CONDUCTOR_SILENT_NS and nobody_acts(memory) and not made_safe(memory)


def outlive(config: RigConfig, memory: RunMemory) -> None:
    """Wait until somebody has made the bench safe; where nobody acts, do it, and stop the run.

    A machine that stood still as a whole makes everybody look silent: those who wake with it have acted by the end.
    """
    until = time.monotonic() + OUTLIVE_S
    while time.monotonic() < until and not made_safe(memory):
        time.sleep(0.005)
    if not made_safe(memory) and nobody_acts(memory):
        memory.set("stop", memory.get("stop") or Stop.SILENT)
        stand_in(config, memory)


def stand_in(config: RigConfig, memory: RunMemory) -> str:
    """Write the safe state, end control and the watchdog, which may only sleep, and write it again.

    Returns what kept it from being written, empty when nothing did.
    """
    _write(config, memory)
    for name in ("control_pid", "watchdog_pid"):
        if pid := memory.get(name):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
    time.sleep(0.005)
    # A card that lets in one process is free only once who had it is gone, which takes as long as its memory is large;
    # and who was killed may have written once more before it died.
    until = time.monotonic() + FREED_S
    while (trouble := _write(config, memory)) and time.monotonic() < until:
        time.sleep(0.005)
    return trouble


def _write(config: RigConfig, memory: RunMemory) -> str:
    try:
        bench = open_bench(config, watchdog=True)
    except CardError as error:
        return str(error)
    try:
        bench.make_safe(vent=memory.get("stop") == Stop.VENT)
        memory.set("safe_ns", memory.get("safe_ns") or time.monotonic_ns())
    except CardError as error:
        return str(error)
    finally:
        bench.close()
    return ""
