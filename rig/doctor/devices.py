"""Checks of a rig's devices by their drivers, of softrig and of plug-ins."""

from __future__ import annotations

from collections.abc import Iterator

from rig.config.drivers import DeviceSection, Finding, resolved
from rig.config.schema import RigConfig


def rig_devices(config: RigConfig) -> Iterator[Finding]:
    """What each driver finds about the devices of a rig; a check that fails is a finding itself."""
    for name, card in config.cards.items():
        yield from _findings(config, f"rig's card {name}", name, card)
    for name, camera in config.cameras.items():
        yield from _findings(config, f"rig's camera {name}", name, camera)
    for name, tracker in config.trackers.items():
        yield from _findings(config, f"rig's tracker {name}", name, tracker)


def _findings(config: RigConfig, topic: str, name: str, device: DeviceSection) -> Iterator[Finding]:
    registry, driver = device.registry, device.driven_by
    package = registry.package(device.driver)
    if device.driver not in registry.built_in or (driver.examine is None and not driver.simulated):
        about = f"driver {device.driver} of {package}: {driver.about}"
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
