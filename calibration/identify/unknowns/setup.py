"""Setup of an identification: an arm and how it is mounted and measured."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

import model
from model.arrays import Array

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class SectionMount:
    """How far the board of a section is from where the rig states it: a point and a rotation vector in its frame."""

    name: str
    offset_m: Triple = (0.0, 0.0, 0.0)
    rotation_rad: Triple = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Setup:
    """An arm and how it is mounted and measured.

    A tip of the model at (p, R) is measured at B (p + R tool) + base: `base_translation_m` and the rotation vector
    `base_rotation_rad` are the rod base in the frame of the measurements, `tool_offset_m` the measured point in the
    tip frame. Its orientation is measured as B R T: the rotation vector `tool_rotation_rad` is the measured frame in
    the tip frame. `actuator_turn_rad` (N,) moves each actuator about the arm's axis. The rotation vector
    `gravity_turn_rad` turns gravity in the rod-base frame: a base that is not plumb. Sensors read `sensor_gain` (N,)
    times their pressure plus `sensor_offset_pa` (N,), `sensor_lag_s` late as clocks are, and behind a filter of first
    order with the time constant `sensor_filter_s`. A section of the arm is measured as the tip is, with the mount of
    its own board in `sections` in place of the tool; a section without one is where the rig states it.
    """

    arm: model.Arm
    base_translation_m: Triple = (0.0, 0.0, 0.0)
    base_rotation_rad: Triple = (0.0, 0.0, 0.0)
    tool_offset_m: Triple = (0.0, 0.0, 0.0)
    tool_rotation_rad: Triple = (0.0, 0.0, 0.0)
    actuator_turn_rad: tuple[float, ...] = ()
    gravity_turn_rad: Triple = (0.0, 0.0, 0.0)
    sensor_offset_pa: tuple[float, ...] = ()
    sensor_gain: tuple[float, ...] = ()
    sensor_lag_s: float = 0.0
    sensor_filter_s: float = 0.0
    sections: tuple[SectionMount, ...] = ()

    def __post_init__(self) -> None:
        n = self.arm.actuators
        for name, neutral in (("actuator_turn_rad", 0.0), ("sensor_offset_pa", 0.0), ("sensor_gain", 1.0)):
            if not getattr(self, name):
                object.__setattr__(self, name, (neutral,) * n)

    @cached_property
    def turned_arm(self) -> model.Arm:
        """The arm with its actuators and gravity where they are."""
        arm = self.arm
        if any(self.gravity_turn_rad):
            gravity = Rotation.from_rotvec(self.gravity_turn_rad).apply(arm.gravity_m_s2)
            arm = replace(arm, gravity_m_s2=_three(gravity))
        if any(self.actuator_turn_rad):
            turns = iter(self.actuator_turn_rad)
            for k, segment in enumerate(arm.segments):
                turned = tuple(
                    (math.cos(t) * x - math.sin(t) * y, math.sin(t) * x + math.cos(t) * y)
                    for (x, y), t in zip(segment.geometry.actuator_xy_m, turns, strict=False)
                )
                arm = arm.with_segment(k, geometry=replace(segment.geometry, actuator_xy_m=turned))
        return arm

    def without_baseline(self, baseline: Setup) -> Setup:
        """The same arm as a rig without `baseline` measures it, where this is how a rig with `baseline` in it does."""
        turn, tool = Rotation.from_rotvec(baseline.base_rotation_rad), Rotation.from_rotvec(self.tool_rotation_rad)
        return replace(
            self,
            base_translation_m=_three(turn.apply(self.base_translation_m) + baseline.base_translation_m),
            base_rotation_rad=_three((turn * Rotation.from_rotvec(self.base_rotation_rad)).as_rotvec()),
            tool_offset_m=_three(self.tool_offset_m + tool.apply(baseline.tool_offset_m)),
            tool_rotation_rad=_three((tool * Rotation.from_rotvec(baseline.tool_rotation_rad)).as_rotvec()),
            sensor_gain=tuple(np.multiply(self.sensor_gain, baseline.sensor_gain).tolist()),
        )

    def pressure_pa(self, measured_pa: Array) -> Array:
        """True pressures (K, N) behind measured ones."""
        out: Array = (measured_pa - np.array(self.sensor_offset_pa)) / np.array(self.sensor_gain)
        return out

    def tool(self) -> SectionMount:
        """How the measured frame of the tip is mounted."""
        return SectionMount("", self.tool_offset_m, self.tool_rotation_rad)

    def mount(self, section: str) -> SectionMount:
        """How the board of a section is mounted."""
        return next((one for one in self.sections if one.name == section), SectionMount(section))

    def measured(self, point_m: Array, rotation: Array, mount: SectionMount | None = None) -> Array:
        """Where points (K, 3) with orientations (K, 3, 3) of the model are measured, (K, 3) [m]; by default tips."""
        point = point_m + rotation @ np.array((mount or self.tool()).offset_m)
        out: Array = Rotation.from_rotvec(self.base_rotation_rad).apply(point) + np.array(self.base_translation_m)
        return out

    def oriented(self, rotation: Array, mount: SectionMount | None = None) -> Array:
        """How orientations (K, 3, 3) of the model are measured, (K, 3, 3); by default those of tips."""
        base, tool = self.base_rotation_rad, (mount or self.tool()).rotation_rad
        out: Array = Rotation.from_rotvec(base).as_matrix() @ rotation @ Rotation.from_rotvec(tool).as_matrix()
        return out


def _three(values: Array) -> Triple:
    x, y, z = values.tolist()
    return x, y, z
