"""Registries of drivers: those of softrig, and those that other packages install as plug-ins.

One line here registers a driver of softrig. Its module is imported only when a rig uses the driver.
"""

from __future__ import annotations

import functools
import operator
import pkgutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from rig.sections.plugins import PluginError, PluginGroup, PluginSections, package_of


@dataclass(frozen=True)
class Finding:
    """One check of `rig doctor`: its result, and the remedy for a missing part."""

    topic: str
    verdict: Literal["ok", "missing", "note"]
    found: str
    remedy: str = ""


Examine = Callable[[Any, str], Iterable[Finding]]
"""Examines the device of a rig: (RigConfig, name of the device) to findings."""

Silence = Callable[[Any], float]
"""Section of a card to the time [s] without a write after which its device makes the outputs safe by itself."""


@dataclass(frozen=True)
class Plugin:
    """A driver of another package: the object that its entry point names.

    `section` is the model of the device's section in the rig file, a subclass of the one of its kind (`CardConfig`,
    `CameraConfig`, `TrackerConfig`). `open` opens a device: that of a card takes a `CardSetup`, that of a camera
    returns a `CameraDriver`, that of a tracker a `TrackerDriver`. `about` says in one line what it drives, `safe_state`
    what the outputs of a card do once the program is dead.
    A run with a `simulated` device is marked as simulated. `examine` takes the rig's `RigConfig` and the name of a
    device and returns the findings for `rig doctor`; it must not write to the device. `silence_s` is for a card whose
    device makes its outputs safe by itself: it takes the section and returns the time [s] without a write after which
    the device does so. `rig test-driver` checks that.
    """

    section: type[BaseModel]
    open: Callable[..., Any]
    about: str
    safe_state: str = "outputs keep their values"
    simulated: bool = False
    examine: Examine | None = None
    silence_s: Silence | None = None


@dataclass(frozen=True)
class Driver:
    """A registered driver: `opens` names what opens a device, or `plugin` is the object of another package.

    Names are `module:object`. `needs` is what raises an error where the dependencies of the driver are missing.
    `section` is the model of its section in the rig file, where a driver of softrig has one of its own. `checks`
    serves `rig doctor` as `examine` of a plug-in does.
    """

    name: str
    opens: str = ""
    about: str = ""
    safe_state: str = ""
    simulated: bool = False
    section: type[BaseModel] | None = None
    checks: str = ""
    needs: str = ""
    package: str = "softrig"
    plugin: Plugin | None = None

    @property
    def silence_s(self) -> Silence | None:
        """As of a plug-in; drivers of softrig state none."""
        return None if self.plugin is None else self.plugin.silence_s

    def load(self) -> Callable[..., Any]:
        """Return what opens a device; raises what `needs` raises."""
        if self.plugin is not None:
            return self.plugin.open
        if self.needs:
            pkgutil.resolve_name(self.needs)()
        opener: Callable[..., Any] = pkgutil.resolve_name(self.opens)
        return opener

    def load_checks(self) -> Examine | None:
        """Return the function that examines a device for `rig doctor`; None where the driver has none."""
        if self.plugin is not None:
            return self.plugin.examine
        if not self.checks:
            return None
        examine: Examine = pkgutil.resolve_name(self.checks)
        return examine


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


class DriverRegistry:
    """Drivers of one kind of device, by name."""

    def __init__(self, kind: str, *drivers: Driver, has_outputs: bool = False) -> None:
        """`kind` is the section of the rig file; its plug-ins are the entry points `softrig.<kind>`.

        has_outputs: the devices have outputs, whose state matters once the program is dead.
        """
        self.kind = kind
        self._has_outputs = has_outputs
        self.built_in = {driver.name: driver for driver in drivers}
        self._group = PluginGroup(f"softrig.{kind}", self._checked)
        self._base: type[BaseModel] = BaseModel
        self._loaded: dict[str, Driver] = {}

    def __getitem__(self, name: str) -> Driver:
        """A driver by name; imports a plug-in. Raises PluginError."""
        if name in self.built_in:
            return self.built_in[name]
        if name not in self._loaded:
            found, package = self._group.load(name)
            safe_state = found.safe_state if self._has_outputs else ""
            self._loaded[name] = Driver(
                name, "", found.about, safe_state, found.simulated, package=package, plugin=found
            )
        return self._loaded[name]

    def __iter__(self) -> Iterator[str]:
        """Every name, softrig's first; reads the metadata of every installed package."""
        return iter((*self.built_in, *self.plugins()))

    def plugins(self) -> tuple[str, ...]:
        """Names of the installed plug-ins."""
        names = dict.fromkeys(entry.name for entry in self._group.entries())
        return tuple(name for name in names if name not in self.built_in)

    def section(self, name: str) -> type[BaseModel]:
        """Model of the section of a plug-in's device. Raises PluginError."""
        plugin = self[name].plugin
        assert plugin is not None
        return plugin.section

    def any_section(self, base: type[BaseModel], unknown: type[BaseModel]) -> Any:
        """The type of a device's section in the rig file: the model of its driver.

        `base` serves the drivers of softrig that have no model of their own. `unknown` reads the section in an archive
        whose driver is not installed here.
        """
        self._base = base
        sections = [driver.section for driver in self.built_in.values() if driver.section is not None]
        own: Any = base
        if sections:
            own = Annotated[functools.reduce(operator.or_, sections), Field(discriminator="driver")]
        return Annotated[own, PluginSections("driver", base, self.built_in, self.plugins, self.section, unknown)]

    def _checked(self, name: str, found: object) -> Plugin:
        if not isinstance(found, Plugin):
            raise TypeError(f"of type {type(found).__name__}, not a rig.config.drivers.Plugin")
        if not (isinstance(found.section, type) and issubclass(found.section, self._base)):
            raise TypeError(f"`section` is not a subclass of {self._base.__module__}.{self._base.__name__}")
        if not callable(found.open):
            raise TypeError("`open` is not a function")
        return found

    def simulates(self, name: str | None) -> bool:
        """True for a driver of simulated devices; False for one that is not installed."""
        try:
            return name is not None and self[name].simulated
        except PluginError:
            return False

    def extend_schema(self, schema: dict[str, Any]) -> None:
        """Add the names of softrig's drivers to a JSON schema; error messages quote them."""
        schema["enum"] = list(self.built_in)

    def installed(self, base: type[BaseModel]) -> Iterator[InstalledDriver]:
        """Every driver, also a broken one. `base` has the keys that all drivers share."""
        for driver in self.built_in.values():
            yield InstalledDriver(
                self.kind, driver.name, driver.package, driver.about, driver.safe_state, driver.simulated
            )
        for entry in self._group.entries():
            row = InstalledDriver(self.kind, entry.name, package_of(entry))
            if entry.name in self.built_in:
                yield replace(row, fault="not used: softrig has a driver of that name")
                continue
            try:
                found, section = self[entry.name], self.section(entry.name)
            except PluginError as error:
                yield replace(row, fault=str(error))
                continue
            keys = tuple(key for key in section.model_fields if key not in base.model_fields)
            yield replace(row, about=found.about, safe_state=found.safe_state, simulated=found.simulated, keys=keys)


CAMERA_DRIVERS = DriverRegistry(
    "cameras",
    Driver(
        "opencv",
        "rig.hardware.cameras.opencv:OpenCVDriver",
        "V4L2 cameras, folders of pictures and video files",
        checks="rig.doctor.cameras:examine_opencv",
    ),
    Driver(
        "realsense",
        "rig.hardware.cameras.realsense:RealSenseDriver",
        "Intel RealSense by librealsense (softrig[realsense])",
        checks="rig.doctor.cameras:examine_realsense",
    ),
    Driver("mock", "rig.simulator.mock_camera:MockCameraDriver", "a camera of the simulated bench", simulated=True),
)
