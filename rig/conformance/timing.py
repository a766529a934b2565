"""Times of the checks."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CheckTiming:
    """Times of the checks [s], for devices and machines of another speed.

    `sample_s`: how long the inputs are sampled. `settled_s`: for the read-back of a device on a bus. `pressurised_s`:
    how long a valve is driven; a chamber fills in some tenths of a second. `freed_s`: for a card whose process was
    killed. `gone_s`: to detect a device that has gone, beyond `stale_s` of the rig. `start_s`: for a process to start
    and to load the driver. `check_s`: the longest check; one that takes longer waits for a driver that does not return.
    """

    sample_s: float = 1.0
    settled_s: float = 0.1
    pressurised_s: float = 1.0
    freed_s: float = 2.0
    gone_s: float = 1.0
    start_s: float = 120.0
    check_s: float = 30.0


DEFAULT_TIMING = CheckTiming()
