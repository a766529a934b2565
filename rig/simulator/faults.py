"""Fault injection of the simulated bench: faults of sensors, valves, supply, card and camera.

The faults are one structured row: in the shared file of a mock card in real time, in the plant in virtual time. Tests
and the fault campaign (`scripts.faults`) write it; the plant (`rig.simulator.faulty_devices`), the mock card, the mock
camera and the mock tracker apply it. Every process of a run imports this module, so it must not import the compiler.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from rig.hardware.cards.base import CardError, Scans

MOST = 8
"""Sensors, valves and digital inputs that can have a fault."""

FAULTS_DTYPE = np.dtype(
    [
        ("active", "<i8"),
        ("sensor", "<i8", (MOST,)),
        ("sensor_value", "<f8", (MOST,)),
        ("valve", "<i8", (MOST,)),
        ("valve_value", "<f8", (MOST,)),
        ("supply_lost", "<i8"),
        ("failing_reads", "<i8"),
        ("failing_writes", "<i8"),
        ("read_delay_ns", "<i8"),
        ("silent", "<i8"),
        ("lost_scans", "<i8"),
        ("camera", "<i8"),
        ("camera_number", "<i8"),
        ("camera_delay_ns", "<i8"),
        ("contact", "<i8", (MOST,)),
    ]
)
"""`active` is set after the others; `failing_reads`, `failing_writes` and `lost_scans` count down. Pressures are gauge.

`sensor_value` is the standard deviation of the noise or the offset [Pa]; `valve_value` the voltage at which a valve is
stuck (NaN: its present one), or its leakage [l/min at 6 -> 5 bar]. `camera_number` is the camera with the fault, 1 for
the first of the rig, 0 for all. `contact` is 1 where the contact at a digital input is open, `contact_1` that of
channel 0.
"""


class SensorFault(IntEnum):
    """Fault of a pressure sensor."""

    NONE = 0
    OPEN = 1
    SHORT = 2
    FROZEN = 3
    NOISY = 4
    OFFSET = 5


class ValveFault(IntEnum):
    """Fault of a valve."""

    NONE = 0
    STUCK = 1
    LEAKING = 2
    REVERSED = 3


class CameraFault(IntEnum):
    """Fault of a camera."""

    NONE = 0
    UNPLUGGED = 1
    SILENT = 2
    FROZEN = 3
    BLACK = 4
    LATE = 5
    DUPLICATED = 6
    DROPPING = 7


class Faults:
    """A view of the faults of one bench: `row` is an array (1,) of FAULTS_DTYPE."""

    def __init__(self, row: NDArray[np.void] | None = None) -> None:
        """Use a row in shared memory, or a new one."""
        self.row: NDArray[np.void] = np.zeros(1, FAULTS_DTYPE) if row is None else row

    @property
    def active(self) -> bool:
        """True while there is any fault."""
        return bool(self.row["active"][0])

    def camera(self, number: int) -> CameraFault:
        """The fault of a camera, the rig's first being number 1."""
        if not self.active or self.row["camera_number"][0] not in (0, number):
            return CameraFault.NONE
        return CameraFault(int(self.row["camera"][0]))

    def camera_delay_ns(self, number: int) -> int:
        """Delay of a picture of a camera [ns]."""
        return int(self.row["camera_delay_ns"][0]) if self.camera(number) is CameraFault.LATE else 0

    def inject(self, **words: float) -> None:
        """Set fields by name, `sensor_2` being the second of `sensor`; they take effect together."""
        for name, value in words.items():
            stem, _, number = name.rpartition("_")
            if number.isdigit():
                self.row[stem][0, int(number) - 1] = value
            else:
                self.row[name][0] = value
        self.row["active"][0] = 1

    def clear(self) -> None:
        """Remove all faults."""
        self.row["active"][0] = 0
        self.row[:] = np.zeros(1, FAULTS_DTYPE)

    def contacts_closed(self, channels: Sequence[int]) -> NDArray[np.bool_]:
        """Whether the contact at each digital input is closed."""
        is_open = self.row["contact"][0] if self.active else np.zeros(MOST)
        return np.array([c >= MOST or not is_open[c] for c in channels], bool)

    def before_read(self, device: str, *, waits: bool) -> None:
        """Apply the faults of a read of the card; `waits` in real time only. Raises CardError: this read fails."""
        if not self.active:
            return
        if waits and (delay_ns := int(self.row["read_delay_ns"][0])):
            time.sleep(delay_ns * 1e-9)
        if self.row["failing_reads"][0] > 0:
            self.row["failing_reads"][0] -= 1
            raise CardError(f"mock card {device}: the inputs cannot be read: Input/output error")

    def before_write(self, device: str) -> None:
        """Apply the faults of a write to the card. Raises CardError: this write fails."""
        if self.active and self.row["failing_writes"][0] > 0:
            self.row["failing_writes"][0] -= 1
            raise CardError(f"mock card {device}: the outputs cannot be written: Input/output error")

    def of_scans(self, scans: Scans) -> Scans:
        """The scans that remain after the faults."""
        if not self.active:
            return scans
        if self.row["silent"][0]:
            return Scans(scans.t_ns[:0], scans.signals[:0])
        lost = min(int(self.row["lost_scans"][0]), len(scans.t_ns))
        if lost:
            self.row["lost_scans"][0] -= lost
            return Scans(scans.t_ns[lost:], scans.signals[lost:], scans.lost + lost)
        return scans
