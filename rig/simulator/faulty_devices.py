"""Applies injected faults to the valves, the supply and the sensors of the plant."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rig.simulator.faults import MOST, Faults, SensorFault, ValveFault
from rig.simulator.pneumatics import SensorTable, ValveTable
from rig.valves.iso6358 import ATMOSPHERE_PA, sonic_conductance


class FaultyValves:
    """The valves and the supply of the plant with their faults."""

    def __init__(self, faults: Faults, valves: ValveTable) -> None:
        self._faults = faults
        self._valves = valves
        self._healthy = ValveTable._make(array.copy() for array in valves)
        self._held_v: dict[int, float] = {}
        self._changed = False

    def apply(self, outputs_v: NDArray[np.float64], spool_v: NDArray[np.float64]) -> NDArray[np.float64]:
        """Apply the faults to the valves; return their effective voltages (V,) for the outputs `outputs_v`."""
        if not self._faults.active:
            if self._changed:
                self._restore()
            return outputs_v
        self._restore()
        self._changed = True
        row, effective_v = self._faults.row[0], outputs_v.copy()
        if row["supply_lost"]:
            self._valves.supply_pa[:] = ATMOSPHERE_PA
        for i in range(min(MOST, len(outputs_v))):
            fault, value = ValveFault(int(row["valve"][i])), float(row["valve_value"][i])
            if fault is ValveFault.STUCK:
                self._held_v.setdefault(i, float(spool_v[i]) if np.isnan(value) else value)
                effective_v[i] = self._held_v[i]
            else:
                self._held_v.pop(i, None)
            if fault is ValveFault.LEAKING:
                self._valves.leak[i] = sonic_conductance(value, float(self._healthy.critical_ratio[i]))
            elif fault is ValveFault.REVERSED:
                self._valves.fill_sign[i] = -self._healthy.fill_sign[i]
        return effective_v

    def _restore(self) -> None:
        for array, healthy in zip(self._valves, self._healthy, strict=True):
            array[...] = healthy
        self._changed = False


class FaultySensors:
    """The pressure sensors of the plant with their faults."""

    def __init__(self, faults: Faults, sensors: SensorTable) -> None:
        self._faults = faults
        self._sensors = sensors
        self._held_v: dict[int, float] = {}

    def apply(self, first_step: int, scans: NDArray[np.float64]) -> None:
        """Apply the faults to the volts (steps, N) of the grid steps after `first_step`, in place."""
        if not self._faults.active:
            self._held_v.clear()
            return
        sensors = self._sensors
        for a in range(min(MOST, scans.shape[1])):
            fault = SensorFault(int(self._faults.row["sensor"][0, a]))
            if fault is not SensorFault.FROZEN:
                self._held_v.pop(a, None)
            rows = slice(-(first_step + 1) % int(sensors.every[a]), None, int(sensors.every[a]))
            volts = scans[rows, a]
            if len(volts) == 0 or fault is SensorFault.NONE:
                continue
            if fault is SensorFault.FROZEN:
                scans[rows, a] = self._held_v.setdefault(a, float(volts[0]))
            else:
                scans[rows, a] = self._wrong(fault, a, first_step, volts)

    def _wrong(self, fault: SensorFault, a: int, step: int, volts: NDArray[np.float64]) -> NDArray[np.float64]:
        sensors = self._sensors
        low, high = float(sensors.range_low_v[a]), float(sensors.range_high_v[a])
        by_v = float(self._faults.row["sensor_value"][0, a]) * float(sensors.v_per_pa[a])
        match fault:
            case SensorFault.OPEN:
                # The multiplexer charges an open input until it saturates.
                return np.full_like(volts, high)
            case SensorFault.SHORT:
                return np.full_like(volts, min(max(0.0, low), high))
            case SensorFault.NOISY:
                noise = np.random.default_rng([sensors.seed, a, step]).standard_normal(len(volts))
                return np.clip(volts + by_v * noise, low, high)
            case SensorFault.OFFSET:
                return np.clip(volts + by_v, low, high)
            case _:
                raise ValueError(f"sensor fault {fault.name} has no effect on the volts")
