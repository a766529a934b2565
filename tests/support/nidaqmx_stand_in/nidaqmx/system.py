"""The system that NI's driver describes."""

from __future__ import annotations

from typing import NamedTuple


class DriverVersion(NamedTuple):
    """Version of the driver."""

    major_version: int
    minor_version: int
    update_version: int


class System:
    """This computer."""

    @staticmethod
    def local() -> System:
        """It."""
        return System()

    @property
    def driver_version(self) -> DriverVersion:
        """Version of the driver."""
        return DriverVersion(24, 5, 0)
