"""Checks of a rig's devices by the plug-ins that drive them."""

from __future__ import annotations

from collections.abc import Iterator

from rig.config.card_sections import CARD_DRIVERS, CardConfig
from rig.config.drivers import CAMERA_DRIVERS, Driver
from rig.config.finding import Finding
from rig.config.schema import RigConfig
from rig.config.sections import CameraConfig
from rig.config.tracker_sections import TRACKER_DRIVERS, TrackerConfig


def rig_devices(config: RigConfig) -> Iterator[Finding]:
    """What each plug-in finds about its devices; a plug-in that fails is a finding itself."""
    for name, card in config.cards.items():
        if (driver := CARD_DRIVERS[card.driver]).plugin is not None:
            yield from _findings(f"rig's card {name}", name, card, driver)
    for name, camera in config.cameras.items():
        if (driver := CAMERA_DRIVERS[camera.driver]).plugin is not None:
            yield from _findings(f"rig's camera {name}", name, camera, driver)
    for name, tracker in config.trackers.items():
        if (driver := TRACKER_DRIVERS[tracker.driver]).plugin is not None:
            yield from _findings(f"rig's tracker {name}", name, tracker, driver)


def _findings(
    topic: str, name: str, section: CardConfig | CameraConfig | TrackerConfig, driver: Driver
) -> Iterator[Finding]:
    assert driver.plugin is not None
    behind = f"driver {driver.name} of {driver.package}: {driver.about}"
    if driver.safe_state:
        behind += f"; if the program dies: {driver.safe_state}"
    yield Finding(topic, "note", behind, "nothing")
    if driver.plugin.examine is None:
        return
    try:
        yield from driver.plugin.examine(name, section)
    except Exception as error:  # the code of another package may raise anything
        remedy = f"report it to the authors of {driver.package}"
        yield Finding(topic, "missing", f"its check failed: {type(error).__name__}: {error}", remedy)
