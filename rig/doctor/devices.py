"""Checks of a rig's devices by their drivers, of softrig and of plug-ins."""

from __future__ import annotations

from collections.abc import Iterator

from rig.config.card_sections import CARD_DRIVERS
from rig.config.drivers import DriverRegistry, Finding, resolved
from rig.config.schema import RigConfig
from rig.config.sections import CAMERA_DRIVERS
from rig.config.tracker_sections import TRACKER_DRIVERS


def rig_devices(config: RigConfig) -> Iterator[Finding]:
    """What each driver finds about the devices of a rig; a check that fails is a finding itself."""
    for name, card in config.cards.items():
        yield from _findings(config, f"card {name}", name, CARD_DRIVERS, card.driver)
    for name, camera in config.cameras.items():
        yield from _findings(config, f"camera {name}", name, CAMERA_DRIVERS, camera.driver)
    for name, tracker in config.trackers.items():
        yield from _findings(config, f"tracker {name}", name, TRACKER_DRIVERS, tracker.driver)


def _findings(config: RigConfig, device: str, name: str, registry: DriverRegistry, of: str) -> Iterator[Finding]:
    driver, topic, package = registry[of], f"rig's {device}", registry.package(of)
    if of not in registry.built_in or (driver.examine is None and not driver.simulated):
        about = f"driver {of} of {package}: {driver.about}"
        if safe_state := registry.safe_state(driver):
            about += f"; if the program dies: {safe_state}"
        yield Finding(topic, "note", about, "`rig test-driver` checks the device itself")
    if driver.examine is None:
        return
    try:
        yield from resolved(driver.examine)(config, name)
    except Exception as error:  # the code of another package may raise anything
        fault = f"its check failed: {type(error).__name__}: {error}"
        yield Finding(topic, "missing", fault, f"report it to the authors of {package}")
