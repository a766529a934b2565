"""Schema of the rig file.

The YAML uses bar, mm, degrees and volts, with the unit in each key; properties and methods return SI units.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator
from pydantic.json_schema import SkipJsonSchema

from protocols import arguments
from protocols.validation import faults
from rig.config import consistency
from rig.config.arm_sections import ArmConfig
from rig.config.bench import BenchConfig
from rig.config.board_sections import AnyBoard, MeasuredSection
from rig.config.drivers import DeviceSection, Reality
from rig.config.metadata import Metadata
from rig.config.sections import (
    AnyCamera,
    CameraConfig,
    CameraTrigger,
    ModelConfig,
    Recording,
    Sensor,
    TipControlSection,
)
from rig.config.simulator_sections import Simulator
from rig.config.tracker_sections import AnyTracker, TrackerConfig
from rig.config.uncertainties import Uncertainties
from rig.sections.control import Control, Limits
from rig.sections.quantities import Named, NamedOrNone, Word


class RigConfig(BenchConfig):
    """One rig: its bench, and everything about the arm, its measurement and its model."""

    description: str = ""
    calibrations: tuple[Word, ...] = Field(
        default=(), description="files of `rig calibrate`, from this file's folder: they replace what is stated here"
    )
    metadata: Metadata = Metadata()
    sensors: Annotated[tuple[Sensor, ...], Field(min_length=1)]
    limits: Limits
    control: Control
    cameras: Named[AnyCamera] = Field(
        default_factory=dict, description="none: the tip is not measured, a run has pressures and the model only"
    )
    trackers: NamedOrNone[AnyTracker] = Field(
        default_factory=dict, description="a device that gives the pose of the tip itself, in place of cameras"
    )
    board: AnyBoard | SkipJsonSchema[None] = None
    sections: NamedOrNone[MeasuredSection] = Field(
        default_factory=dict, description="boards along the arm, beside the one on the end cap"
    )
    arm: ArmConfig
    uncertainties: Uncertainties = Field(default_factory=Uncertainties)
    model: ModelConfig = ModelConfig()
    tip_control: TipControlSection = TipControlSection()
    recording: Recording = Recording()
    simulator: Simulator | SkipJsonSchema[None] = None

    @model_validator(mode="after")
    def _check(self) -> RigConfig:
        faults(consistency.check(dict(self)))
        return self

    @property
    def actuators(self) -> int:
        """Number of actuators."""
        return self.arm.actuators

    @property
    def valve_of(self) -> tuple[int, ...]:
        """Index of the valve of each actuator (N,)."""
        valves = {actuator: v for v, valve in enumerate(self.valves) for actuator in valve.actuators}
        return tuple(valves[actuator] for actuator in range(1, self.actuators + 1))

    @property
    def first_actuators(self) -> list[int]:
        """Index of the first actuator of each valve (V,): all actuators of a valve have the same set-point."""
        return [valve.actuators[0] - 1 for valve in self.valves]

    @property
    def trigger_outputs(self) -> tuple[CameraTrigger, ...]:
        return tuple(camera.trigger for camera in self.cameras.values() if camera.trigger is not None)

    @property
    def observation_hz(self) -> float:
        """Observations per second: the rate of the cameras or the tracker, without both the rate of the model."""
        return next((source.rate_hz for source in self.tip_sources), self.model.rate_hz)

    @property
    def tracker(self) -> TrackerConfig | None:
        """The tracker that measures the tip; None without one."""
        return next(iter(self.trackers.values()), None)

    @property
    def measures_tip(self) -> bool:
        return bool(self.tip_sources)

    @property
    def tip_sources(self) -> tuple[CameraConfig | TrackerConfig, ...]:
        """Cameras and trackers."""
        return (*self.cameras.values(), *self.trackers.values())

    @property
    def triggered(self) -> bool:
        """True when a card triggers the exposures of the cameras."""
        return any(camera.trigger is not None for camera in self.cameras.values())

    @property
    def free_running(self) -> RigConfig:
        """The rig with cameras that expose by their own clocks."""
        cameras = {name: camera.model_copy(update={"trigger": None}) for name, camera in self.cameras.items()}
        return self.model_copy(update={"cameras": cameras})

    def with_board_of(self, section: str) -> RigConfig:
        """The rig with the board of a section of the arm as the one that is measured."""
        return self.model_copy(update={"board": self.sections[section].board, "sections": {}})

    @property
    def devices(self) -> tuple[DeviceSection, ...]:
        """Cards, cameras and trackers."""
        return (*self.cards.values(), *self.tip_sources)

    @property
    def simulated(self) -> bool:
        """True when any device of the rig is not real: its runs are marked."""
        return any(device.reality is not Reality.REAL for device in self.devices)

    @property
    def as_built(self) -> RigConfig:
        """The rig with the simulator's true parts: calibrations change the stated values only."""
        built = None if self.simulator is None else self.simulator.built
        if built is None:
            return self
        cameras = {n: c.model_copy(update={"lens": built.lenses.get(n, c.lens)}) for n, c in self.cameras.items()}
        return self.model_copy(update={"cameras": cameras, "valves": built.valves, "sensors": built.sensors})


def checked_config(option: str, config: object) -> RigConfig:
    """The configuration of a rig that is given from Python; or `BadInputError`."""
    return arguments.of_type(option, config, RigConfig, "the configuration of a rig, as rig.open(..).config")
