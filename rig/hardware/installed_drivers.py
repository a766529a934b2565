"""Every object that a rig file can name here."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from rig.arm_effects.registry import ARM_EFFECTS
from rig.config.board_sections import BOARDS
from rig.config.card_sections import CARD_DRIVERS
from rig.config.sections import CAMERA_DRIVERS
from rig.config.tip_controllers import CONTROLLERS
from rig.config.tracker_sections import TRACKER_DRIVERS
from rig.sections.registry import Registry
from rig.valves.registry import VALVES

REGISTRIES: tuple[Registry[Any], ...] = (
    CARD_DRIVERS,
    CAMERA_DRIVERS,
    TRACKER_DRIVERS,
    VALVES,
    BOARDS,
    ARM_EFFECTS,
    CONTROLLERS,
)


@dataclass(frozen=True)
class InstalledObject:
    """An object as `rig drivers` lists it; `keys` are its own keys in the rig file, `fault` why it cannot be used."""

    kind: str
    name: str
    package: str
    about: str = ""
    safe_state: str = ""
    simulated: bool = False
    keys: tuple[str, ...] = ()
    fault: str = ""


def installed_drivers() -> Iterator[InstalledObject]:
    """The objects of softrig and of plug-ins, a broken plug-in with its fault; imports all of them."""
    for registry in REGISTRIES:
        for name, package, facts in registry.installed():
            yield InstalledObject(registry.kind, name, package, **facts)
