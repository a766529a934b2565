"""What virtual time needs of a rig: the simulated bench, which has no clock of its own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from protocols.problems import bad_input


class MaybeMock(Protocol):
    """The section of a card, a camera or a tracker."""

    @property
    def is_mock(self) -> bool:
        """True for a device of the simulated bench."""


def require_mocks(rig: str, devices: Mapping[str, MaybeMock]) -> None:
    """Refuse virtual time for devices that only real time can drive, also those that another driver simulates.

    Raises:
        BadInputError: a device does not belong to the simulated bench.
    """
    if others := [name for name, device in devices.items() if not device.is_mock]:
        found = f"virtual time on rig {rig}, with {', '.join(others)}"
        raise bad_input("--fast", found, "softrig's simulated bench (driver: mock); omit --fast for this rig")
