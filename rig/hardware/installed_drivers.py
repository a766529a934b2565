"""Every driver and valve type that a rig file can name here."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from pydantic import BaseModel

from rig.config.card_sections import CARD_DRIVERS
from rig.config.sections import CAMERA_DRIVERS
from rig.config.tracker_sections import TRACKER_DRIVERS
from rig.valves.base import ValveSection
from rig.valves.registry import VALVES


@dataclass(frozen=True)
class InstalledDriver:
    """A driver as `rig drivers` lists it; `keys` are its own keys in the rig file, `fault` why it cannot be used."""

    kind: str
    name: str
    package: str
    about: str = ""
    safe_state: str = ""
    simulated: bool = False
    keys: tuple[str, ...] = ()
    fault: str = ""


def installed_drivers() -> Iterator[InstalledDriver]:
    """The drivers of softrig and of plug-ins, a broken plug-in with its fault; imports every plug-in."""
    for registry in (CARD_DRIVERS, CAMERA_DRIVERS, TRACKER_DRIVERS):
        for name, package, driver, fault in registry.installed():
            row = InstalledDriver(registry.kind, name, package, fault=fault)
            if driver is not None:
                keys, safe_state = _own_keys(driver.section, registry.base), registry.safe_state(driver)
                row = replace(row, about=driver.about, safe_state=safe_state, simulated=driver.simulated, keys=keys)
            yield row
    for name, package, valve, fault in VALVES.installed():
        row = InstalledDriver("valves", name, package, fault=fault)
        if valve is not None:
            about = (valve.__doc__ or "").strip().split("\n")[0]
            row = replace(row, about=about, keys=_own_keys(valve, ValveSection))
        yield row


def _own_keys(section: type[BaseModel], base: type[BaseModel]) -> tuple[str, ...]:
    return tuple(key for key in section.model_fields if key not in base.model_fields)
