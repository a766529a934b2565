"""Checks of a rig's devices by their drivers, of softrig and of plug-ins."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from rig.config.card_sections import CARD_DRIVERS
from rig.config.drivers import CAMERA_DRIVERS, Driver, Finding
from rig.config.schema import RigConfig
from rig.config.tracker_sections import TRACKER_DRIVERS


def rig_devices(config: RigConfig) -> Iterator[Finding]:
    """What each driver finds about the devices of a rig; a check that fails is a finding itself."""
    for kind, name, driver in _drivers(config):
        yield from _findings(config, kind, name, driver)


def _drivers(config: RigConfig) -> Iterable[tuple[str, str, Driver]]:
    yield from (("card", name, CARD_DRIVERS[card.driver]) for name, card in config.cards.items())
    yield from (("camera", name, CAMERA_DRIVERS[camera.driver]) for name, camera in config.cameras.items())
    yield from (("tracker", name, TRACKER_DRIVERS[tracker.driver]) for name, tracker in config.trackers.items())


def _findings(config: RigConfig, kind: str, name: str, driver: Driver) -> Iterator[Finding]:
    topic = f"rig's {kind} {name}"
    examine = driver.load_checks()
    if driver.plugin is not None or (examine is None and not driver.simulated):
        about = f"driver {driver.name} of {driver.package}: {driver.about}"
        if driver.safe_state:
            about += f"; if the program dies: {driver.safe_state}"
        yield Finding(topic, "note", about, "`rig test-driver` checks the device itself")
    if examine is None:
        return
    try:
        yield from examine(config, name)
    except Exception as error:  # the code of another package may raise anything
        yield Finding(
            topic,
            "missing",
            f"its check failed: {type(error).__name__}: {error}",
            f"report it to the authors of {driver.package}",
        )
