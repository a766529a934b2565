"""Every driver and valve type that a rig file can name here."""

from __future__ import annotations

from collections.abc import Iterator

from rig.config.card_sections import CARD_DRIVERS, CardConfig
from rig.config.drivers import CAMERA_DRIVERS, InstalledDriver
from rig.config.sections import CameraConfig
from rig.config.tracker_sections import TRACKER_DRIVERS, TrackerConfig
from rig.sections.plugins import PluginError, package_of
from rig.valves.base import ValveSection
from rig.valves.registry import BUILT_IN, VALVE_PLUGINS


def installed_drivers() -> Iterator[InstalledDriver]:
    """The drivers of softrig and of plug-ins, a broken plug-in with its fault; imports every plug-in."""
    yield from CARD_DRIVERS.installed(CardConfig)
    yield from CAMERA_DRIVERS.installed(CameraConfig)
    yield from TRACKER_DRIVERS.installed(TrackerConfig)
    for name, valve in BUILT_IN.items():
        yield _valve(name, "softrig", valve)
    for entry in VALVE_PLUGINS.entries():
        if entry.name in BUILT_IN:
            fault = "not used: softrig has a valve type of that name"
            yield InstalledDriver("valves", entry.name, package_of(entry), fault=fault)
            continue
        try:
            yield _valve(entry.name, package_of(entry), VALVE_PLUGINS.load(entry.name)[0])
        except PluginError as error:
            yield InstalledDriver("valves", entry.name, package_of(entry), fault=str(error))


def _valve(name: str, package: str, valve: type[ValveSection]) -> InstalledDriver:
    about = (valve.__doc__ or "").strip().split("\n")[0]
    keys = tuple(key for key in valve.model_fields if key not in ValveSection.model_fields)
    return InstalledDriver("valves", name, package, about, keys=keys)
