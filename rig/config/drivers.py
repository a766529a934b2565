"""Drivers of cards, cameras and trackers: those of softrig, and those that other packages install as plug-ins.

softrig registers its own beside the sections of the rig file: `CARD_DRIVERS`, `CAMERA_DRIVERS`, `TRACKER_DRIVERS`.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, Field

from rig.sections.base import Section
from rig.sections.plugins import PluginSections, own_keys, uninstalled
from rig.sections.registry import PluginError, Registry


@dataclass(frozen=True)
class Finding:
    """One check of `rig doctor`: its result, and the remedy for a missing part."""

    topic: str
    verdict: Literal["ok", "missing", "note"]
    found: str
    remedy: str = ""


class Reality(StrEnum):
    """Whether a device is real. A run on a device that is not is marked as simulated."""

    REAL = "real"
    EMULATED = "emulated"
    """Another program stands for the hardware. softrig asks before a valve moves, as on a real device."""
    SIMULATED = "simulated"
    """A device of softrig's simulated bench, which also runs in virtual time."""


Examine = Callable[[Any, str], Iterable[Finding]]
"""Examines the device of a rig: (RigConfig, name of the device) to findings."""


@dataclass(frozen=True)
class Driver:
    """A driver: an object that the entry point of a package names, or one that softrig registers.

    `section` is the model of the device's section in the rig file, a subclass of the one of its kind (`CardConfig`,
    `CameraConfig`, `TrackerConfig`). `open` opens a device: that of a card takes a `CardSetup`, that of a camera or
    tracker the rig's `RigConfig`, the name of the device and a seed for simulated ones. `about` says in one line what
    it drives, `safe_state` what the outputs of a card do once the program is dead.
    A run with a `simulated` device is marked as simulated. `examine` takes the rig's `RigConfig` and the name of a
    device and returns the findings for `rig doctor`; it must not write to the device. `serial` takes the section of a
    camera and returns its serial number as it is plugged in now, None where it is not there. `silence_s` is for a card
    whose device makes its outputs safe by itself: it takes the section and returns the time [s] without a write after
    which the device does so. `rig test-driver` checks that. `needs` raises an error where what the driver needs is
    missing.
    A function may be its name, `module:object`; the module is imported only when a rig uses the driver.
    """

    section: type[BaseModel]
    open: Callable[..., Any] | str
    about: str
    safe_state: str = "outputs keep their values"
    simulated: bool = False
    examine: Examine | str | None = None
    silence_s: Callable[[Any], float] | None = None
    serial: Callable[[Any], str | None] | str | None = None
    needs: str | None = None

    def load(self) -> Callable[..., Any]:
        """Return what opens a device; raises what `needs` raises."""
        if self.needs is not None:
            resolved(self.needs)()
        return resolved(self.open)


def resolved(function: Callable[..., Any] | str) -> Callable[..., Any]:
    """A function; one that is named is imported."""
    found: Callable[..., Any] = pkgutil.resolve_name(function) if isinstance(function, str) else function
    return found


class DeviceSection(Section):
    """The section of a device in the rig file. A driver adds keys of its own in a subclass."""

    registry: ClassVar[DriverRegistry]
    """The drivers of this kind of device."""
    driver: Annotated[str, Field(min_length=1)]

    @property
    def reality(self) -> Reality:
        """Whether the device is real."""
        return self.registry.reality(self.driver)

    @property
    def driven_by(self) -> Driver:
        """The driver that `driver` names. Raises PluginError."""
        return self.registry[self.driver]


class DriverRegistry(Registry[Driver]):
    """Drivers of one kind of device, by name."""

    def __init__(
        self, kind: str, base: type[DeviceSection], drivers: Mapping[str, Driver], *, has_outputs: bool = False
    ) -> None:
        """`kind` is the section of the rig file; its plug-ins are the entry points `softrig.<kind>`.

        `base` has the keys that all sections share. has_outputs: the devices have outputs, whose state matters once the
        program is dead.
        """
        super().__init__(kind, drivers)
        self.base, self._has_outputs = base, has_outputs
        base.registry = self

    def section(self, **members: object) -> Any:
        """The type of a device's section in the rig file: the model of its driver.

        `members` are attributes of the section in an archive whose driver is not installed here.
        """
        unknown = uninstalled(self.base, "driver", **members)
        return PluginSections(self, "driver", self.base, lambda driver: driver.section, unknown).section

    def checked(self, found: object) -> Driver:
        if not isinstance(found, Driver):
            raise TypeError(f"of type {type(found).__name__}, not a rig.config.drivers.Driver")
        if not (isinstance(found.section, type) and issubclass(found.section, self.base)):
            raise TypeError(f"`section` is not a subclass of {self.base.__module__}.{self.base.__name__}")
        if not callable(found.open):
            raise TypeError("`open` is not a function")
        return found

    def facts(self, found: Driver) -> dict[str, Any]:
        """What it drives, its own keys, and what its outputs do once the program is dead."""
        keys = own_keys(found.section, self.base)
        state = self.safe_state(found)
        return {"about": found.about, "safe_state": state, "simulated": found.simulated, "keys": keys}

    def reality(self, name: str | None) -> Reality:
        """Whether the devices of a driver are real; those of one that is not installed are."""
        if name == "mock":
            return Reality.SIMULATED
        try:
            return Reality.EMULATED if name is not None and self[name].simulated else Reality.REAL
        except PluginError:
            return Reality.REAL

    def safe_state(self, driver: Driver) -> str:
        """What the outputs do once the program is dead; empty for devices without outputs."""
        return driver.safe_state if self._has_outputs else ""
