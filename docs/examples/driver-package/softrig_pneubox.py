"""A softrig driver: the Pneubox, a simulated box of pressure regulators and sensors.

Its state is a file, so that several processes drive one box, as they drive a real device. A regulator takes 0 to 10 V
for 0 to 2 bar, a sensor tells 0 to 10 V for 0 to 10 bar. A box that is not written for `silence_ms` vents by itself.
"""

from __future__ import annotations

import math
import mmap
import tempfile
import time
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from rig.config.card_sections import CardConfig
from rig.config.drivers import Driver, Finding
from rig.config.schema import RigConfig
from rig.hardware.cards.base import CardError, CardSetup, Scans
from rig.sections.quantities import Positive

CHANNELS = 8
BAR_PER_V, SENSOR_V_PER_BAR = 0.2, 1.0


class PneuboxConfig(CardConfig):
    """The keys of every card, and these."""

    lag_ms: Positive = 50.0
    silence_ms: Annotated[float, Field(ge=20, le=1000)] = 100.0


def file_of(device: str) -> Path:
    """The state of a box: outputs [V], pressures [bar], time of the last step and of the last write [ns]."""
    return Path(tempfile.gettempdir()) / f"{device}.pneubox"


def power_up(device: str) -> None:
    """Make a box; every chamber is empty."""
    np.append(np.zeros(2 * CHANNELS), [time.monotonic_ns()] * 2).tofile(file_of(device))


class Pneubox:
    """An open box."""

    def __init__(self, setup: CardSetup) -> None:
        """Open the box. Raises CardError."""
        self._config: PneuboxConfig = setup.section
        self._inputs, self._outputs = ([c.number for c in channels] for channels in (setup.inputs, setup.outputs))
        if max((*self._inputs, *self._outputs), default=0) >= CHANNELS:
            raise CardError(f"box {setup.device} has channels 0 to {CHANNELS - 1} only")
        self._setup = setup
        try:
            with file_of(setup.device).open("r+b") as file:
                self._memory = mmap.mmap(file.fileno(), 0)
        except (OSError, ValueError) as error:
            raise CardError(f"box {setup.device} cannot be opened: {error}", "switch it on") from error
        state = np.frombuffer(self._memory, np.float64)
        self._volts, self._bar, self._times = np.split(state, [CHANNELS, 2 * CHANNELS])
        self._started = False

    def start(self) -> None:
        """Sample from now on."""
        self._started = True

    def read(self) -> Scans:
        """One scan, taken now; none before `start`."""
        times = np.array([self._step()] if self._started else [], np.int64)
        return Scans(times, np.tile(self._bar[self._inputs] * SENSOR_V_PER_BAR, (len(times), 1)))

    def write(self, outputs: NDArray[np.float64]) -> None:
        """Set the outputs, each within its range; a number that is not finite is refused."""
        inside = self._setup.clipped(outputs)
        self._times[1] = self._step()
        self._volts[self._outputs] = inside

    def readback(self) -> NDArray[np.float64]:
        """The outputs as the box has them."""
        self._step()
        return np.array(self._volts[self._outputs])

    def close(self) -> None:
        """Release the box; its outputs keep their values until its silence is over."""
        self._volts = self._bar = self._times = np.empty(0)

    def _step(self) -> int:
        """What happens inside the box until now [ns]."""
        if not file_of(self._setup.device).exists():
            raise CardError(f"box {self._setup.device} has gone", "switch it on")
        now = time.monotonic_ns()
        if now - self._times[1] > self._config.silence_ms * 1e6:
            self._volts[:] = 0.0
        share = -math.expm1(-max(0.0, now - self._times[0]) / (self._config.lag_ms * 1e6))
        self._bar += share * (self._volts * BAR_PER_V - self._bar)
        self._times[0] = now
        return now


def examine(config: RigConfig, name: str) -> list[Finding]:
    """Whether the box is there, for `rig doctor`."""
    on = file_of(config.cards[name].device).exists()
    return [Finding(f"box {name}", "ok", "on") if on else Finding(f"box {name}", "missing", "off", "switch it on")]


pneubox = Driver(
    PneuboxConfig,
    Pneubox,
    about="the Pneubox, a simulated pressure controller",
    safe_state="the box vents by itself after silence_ms",
    simulated=True,
    examine=examine,
    silence_s=lambda section: section.silence_ms * 1e-3,
)
