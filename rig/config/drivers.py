"""Registry of card and camera drivers: name, module, and whether the device is simulated.

One line here registers a driver. The function `driver()` of its module imports the dependencies and returns the
function that opens a device; it runs only when a rig uses the driver.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic_core import PydanticCustomError


@dataclass(frozen=True)
class Driver:
    """A registered driver; `module` holds its `driver()` function."""

    name: str
    module: str
    simulated: bool = False

    def load(self) -> Callable[..., Any]:
        """Return the function that opens a device; raises what `driver()` of the module raises."""
        opener: Callable[..., Any] = importlib.import_module(self.module).driver()
        return opener


class DriverRegistry(Mapping[str, Driver]):
    """Drivers of one kind of device, by name."""

    def __init__(self, *drivers: Driver) -> None:
        self._drivers = {driver.name: driver for driver in drivers}

    def __getitem__(self, name: str) -> Driver:
        return self._drivers[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._drivers)

    def __len__(self) -> int:
        return len(self._drivers)

    def register(self, driver: Driver) -> None:
        """Add a driver.

        Raises:
            ValueError: the name is registered already.
        """
        if driver.name in self._drivers:
            raise ValueError(f"a driver named {driver.name} is registered already")
        self._drivers[driver.name] = driver

    def simulates(self, name: str | None) -> bool:
        """Return True for a registered driver of simulated devices."""
        return name in self._drivers and self._drivers[name].simulated

    def check(self, name: str) -> str:
        """Return the name of a registered driver; for pydantic, which reports any other name."""
        if name not in self._drivers:
            raise PydanticCustomError("unknown_driver", "one of {names}", {"names": ", ".join(self._drivers)})
        return name

    def extend_schema(self, schema: dict[str, Any]) -> None:
        """Add the drivers' names to a JSON schema; error messages quote them."""
        schema["enum"] = list(self._drivers)


CARD_DRIVERS = DriverRegistry(
    Driver("comedi", "rig.hardware.cards.comedi"),
    Driver("mock", "rig.hardware.cards.mock", simulated=True),
)
CAMERA_DRIVERS = DriverRegistry(
    Driver("opencv", "rig.hardware.cameras.opencv"),
    Driver("realsense", "rig.hardware.cameras.realsense"),
    Driver("mock", "rig.hardware.cameras.mock", simulated=True),
)
