"""The camera trigger: control gives the pulses, at whole control cycles."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rig.config.schema import RigConfig
from rig.hardware.bench import Bench
from runs.records import blank, pulse_dtype

PAUSE_FRAMES = 2
"""Frame periods without a pulse before a run begins: a camera that exposes by its own clock shows itself there."""


class TriggerPulses:
    """Pulses of the camera trigger: one per frame period. Jitter shortens an interval by one control period at most."""

    def __init__(self, config: RigConfig, bench: Bench, clock: Callable[[], int]) -> None:
        """`clock` returns the time [ns]; the edge of a pulse is stamped by it before and after the write."""
        camera = next(iter(config.cameras.values()))
        assert camera.trigger is not None
        rate_hz, width_ms = config.control.rate_hz, camera.trigger.width_ms
        self._cycles = round(rate_hz / camera.rate_hz)
        self._width = 1 if width_ms is None else round(width_ms * 1e-3 * rate_hz)
        self._cycle_ns = round(1e9 / rate_hz)
        self._bench, self._clock = bench, clock
        self._row: NDArray[np.void] = blank((), pulse_dtype())
        self._due: int | None = None
        self._falls = self._pulse = self._quiet_until_ns = self._rise_ns = 0
        self._high = False

    def cycle(self, number: int) -> NDArray[np.void] | None:
        """Set the output for one control cycle; return the row (reused) of a pulse that begins, else None.

        A pulse that is due in a missed cycle begins late, and those after it follow at the frame period. `skipped`
        counts the whole frame periods that were missed.

        Raises:
            CardError: the output cannot be written.
        """
        if self._high and number >= self._falls:
            self._bench.write_trigger(high=False)
            self._high = False
        if self._due is not None and number < self._due:
            return None
        before_ns = self._clock()
        if before_ns < self._quiet_until_ns:
            return None
        self._bench.write_trigger(high=True)
        after_ns = self._clock()
        self._high, self._rise_ns = True, (before_ns + after_ns) // 2
        # A write that took long delays the next pulse, too: a camera that is still busy takes none.
        self._quiet_until_ns = after_ns + (self._cycles - 1) * self._cycle_ns
        row = self._row
        row["t_ns"], row["pulse"] = self._rise_ns, self._pulse
        row["skipped"] = 0 if self._due is None else (number - self._due) // self._cycles
        row["write_s"] = (after_ns - before_ns) * 1e-9
        self._due, self._falls, self._pulse = number + self._cycles, number + self._width, self._pulse + 1
        return row

    def restart(self) -> None:
        """Restart the count of cycles; the next pulse begins PAUSE_FRAMES frame periods after the last."""
        self._due, self._falls = None, 0
        self._quiet_until_ns = self._rise_ns + PAUSE_FRAMES * self._cycles * self._cycle_ns
