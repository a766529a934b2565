"""Vent verification: checks by the sensors that the chambers vent after the safe state is written."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rig.config.schema import RigConfig
from rig.config.sections import PA_PER_BAR
from rig.hardware.bench import Bench

PATIENCE_S = 1.0
"""Default time limit; a chamber vents in a few tenths of a second."""
VENTED_PA = 0.1 * PA_PER_BAR


class VentVerification:
    """Checks the pressures of the chambers whose safe state is vented; with `vent`, of all chambers."""

    def __init__(self, config: RigConfig, bench: Bench, *, vent: bool = False, patience_s: float = PATIENCE_S) -> None:
        """`patience_s` is how long the caller waits; it is part of the message."""
        self._patience_s = patience_s
        self._bench = bench
        venting = [a - 1 for valve in config.valves if vent or valve.safe_state == "vent" for a in valve.actuators]
        self._venting: NDArray[np.int64] = np.array(sorted(venting), np.int64)
        self._pressure_pa: NDArray[np.float64] | None = None

    def done(self) -> bool:
        """Read the newest scans; True once every chamber is empty.

        Raises:
            CardError: the card cannot be read.
        """
        scans = self._bench.read()
        if len(scans.t_ns):
            self._pressure_pa = scans.pressure_pa[-1, self._venting]
        return self._pressure_pa is not None and bool(np.all(self._pressure_pa < VENTED_PA))

    def verdict(self) -> str:
        """Message about chambers that are not empty; empty if all are empty or there is no scan."""
        if self._pressure_pa is None:
            return ""
        full = [
            f"actuator {a + 1} at {p / PA_PER_BAR:.2f} bar"
            for a, p in zip(self._venting.tolist(), self._pressure_pa.tolist(), strict=True)
            if p >= VENTED_PA
        ]
        if not full:
            return ""
        return (
            f"{', '.join(full)} {self._patience_s:g} s after the valves were commanded to vent: a valve is stuck or "
            "its ports are the wrong way round, or a sensor is broken; shut the air off by hand"
        )
