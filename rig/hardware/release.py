"""Releasing cards, cameras and trackers at the end of their use."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from typing import Protocol


class OpenDevice(Protocol):
    """An open card, camera or tracker."""

    def close(self) -> None:
        """Release the device."""


def release(devices: Iterable[OpenDevice]) -> None:
    """Close every device; the outputs of cards keep their values.

    What a driver raises here moves no valve and loses no data, so it ends no run and no `rig vent`. The contract test
    of drivers reports it.
    """
    for device in devices:
        with suppress(Exception):
            device.close()
