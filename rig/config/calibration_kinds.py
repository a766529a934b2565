"""The overlay of each kind of calibration file: what it changes in a rig file, and which rigs it belongs to."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np

from protocols import Problem
from protocols.document import Document
from protocols.problems import closest
from protocols.source_positions import YamlPath
from rig.config.calibration_files import LoadedCalibration
from rig.config.calibration_schema import (
    CalibrationFile,
    CameraFile,
    CameraIdentity,
    DLTFile,
    GravityFile,
    PressureFile,
    SensorCalibration,
    ToolFile,
    ValveCalibration,
)
from rig.config.draft import Draft
from rig.config.optics import placement_of, rigid
from rig.config.sections import LensConfig, Placement, Sensor
from rig.sections.base import Section
from rig.valves.base import ValveSection
from rig.valves.metering import CALIBRATED_KEYS, MeteringValve

Problems = Iterator[Problem]
File = TypeVar("File", bound=CalibrationFile)


class CalibratedPart(NamedTuple):
    """One part of a rig that a file calibrates: its path in the file's YAML, a unique key, a description."""

    path: YamlPath
    key: tuple[str, object]
    description: str


class CalibrationOverlay(ABC, Generic[File]):
    """One calibration file as a change of a rig file."""

    first: ClassVar[bool] = False
    """Whether other overlays depend on what this one puts."""

    def __init__(self, source: Document, found: File) -> None:
        self.source = source
        self.found = found

    @abstractmethod
    def subjects(self) -> Iterator[CalibratedPart]:
        """Yield what the file calibrates."""

    @abstractmethod
    def apply(self, draft: Draft) -> None:
        """Put the calibrated values on a rig file to which this file belongs."""

    def cameras(self) -> Iterator[tuple[YamlPath, CameraIdentity]]:
        """Yield the cameras that the file is for, with their paths in its YAML."""
        return iter(())

    def misfits(self, draft: Draft) -> Problems:
        """Yield the reasons why the file does not belong to the rig."""
        for path, camera in self.cameras():
            yield from _other_camera(draft, self.source, path, camera)


class LensOverlay(CalibrationOverlay[CameraFile]):
    """The lens of a camera."""

    first = True

    def subjects(self) -> Iterator[CalibratedPart]:
        name = self.found.camera.name
        yield CalibratedPart(("camera", "name"), ("lens", name), f"the lens of camera '{name}'")

    def apply(self, draft: Draft) -> None:
        lens = self.found.lens.model_dump(mode="json")
        draft.put(("cameras", self.found.camera.name, "lens"), lens, self.source, ("lens",))

    def cameras(self) -> Iterator[tuple[YamlPath, CameraIdentity]]:
        yield ("camera",), self.found.camera


class PlacementOverlay(CalibrationOverlay[DLTFile]):
    """The places of cameras."""

    def subjects(self) -> Iterator[CalibratedPart]:
        for i, item in enumerate(self.found.cameras):
            name = item.camera.name
            yield CalibratedPart(("cameras", i, "camera", "name"), ("place", name), f"the place of camera '{name}'")

    def apply(self, draft: Draft) -> None:
        for index, camera in enumerate(self.found.cameras):
            self._place(draft, camera.camera.name, camera.placement, ("cameras", index, "placement"))

    def _place(self, draft: Draft, name: str, found: Placement, at: YamlPath) -> None:
        simulator, stated = draft.simulator, draft.part(Placement, "cameras", name, "placement")
        if simulator is not None and stated is not None:
            # The true camera pose stays: the stated placement changes, so the simulated error absorbs the difference.
            true = rigid(stated) @ rigid(simulator.error_of(name))
            error = placement_of(rigid(found).inverse() @ true).model_dump(mode="json")
            draft.put(("simulator", "camera_errors", name), error, self.source, at)
        draft.put(("cameras", name, "placement"), found.model_dump(mode="json"), self.source, at)

    def cameras(self) -> Iterator[tuple[YamlPath, CameraIdentity]]:
        for i, item in enumerate(self.found.cameras):
            yield ("cameras", i, "camera"), item.camera

    def misfits(self, draft: Draft) -> Problems:
        """As of every file; another frame, and another lens: a place is valid only with the lens it was found with."""
        yield from super().misfits(draft)
        if self.found.world != "rod base":
            expected = "rod base: the placements of cameras are in it; calibrate with control points in it, or --base"
            yield self.source.problem(("world",), expected)
        for i, item in enumerate(self.found.cameras):
            name = item.camera.name
            used: LensConfig | None = draft.part(LensConfig, "cameras", name, "lens")
            if item.lens is None or used is None:
                continue
            mine, theirs = (np.array([v.fx_px, v.fy_px, v.cx_px, v.cy_px, *v.distortion]) for v in (item.lens, used))
            if not np.allclose(mine, theirs, rtol=1e-5, atol=1e-7):
                expected = f"{used.fx_px:g} and so on, the lens of camera {name} in rig {draft.name}: the place was "
                expected += "found through another lens; name that lens's calibration, too"
                yield self.source.problem(("cameras", i, "lens"), expected, f"fx_px {item.lens.fx_px:g}")


class BoardOverlay(CalibrationOverlay[ToolFile]):
    """The board on the tip."""

    def subjects(self) -> Iterator[CalibratedPart]:
        yield CalibratedPart(("kind",), ("tool", ""), "the board on the tip")

    def apply(self, draft: Draft) -> None:
        placement = self.found.placement.model_dump(mode="json")
        draft.put(("board", "placement"), placement, self.source, ("placement",))

    def cameras(self) -> Iterator[tuple[YamlPath, CameraIdentity]]:
        yield ("camera",), self.found.camera

    def misfits(self, draft: Draft) -> Problems:
        yield from super().misfits(draft)
        if draft.get("board") is None:
            expected = f"no calibration of a tool: rig {draft.name} has no board"
            yield self.source.problem(("board",), expected, "a board")
            return
        if (stated := draft.board) is None:
            return
        board, wanted = self.found.board, stated.pattern
        if board.kind != wanted.kind:
            expected = f"a {wanted.kind}, as the board of rig {draft.name}"
            yield self.source.problem(("board",), expected, f"a {board.kind}")
            return
        yield from _unlike(self.source, ("board",), board, wanted.model_dump(), f"as the board of rig {draft.name}")


class PressureOverlay(CalibrationOverlay[PressureFile]):
    """The scales of pressure sensors, and the flow curves of valves."""

    def subjects(self) -> Iterator[CalibratedPart]:
        for i, scale in enumerate(self.found.sensors):
            description = f"the sensor of actuator {scale.actuator}"
            yield CalibratedPart(("sensors", i, "actuator"), ("sensor", scale.actuator), description)
        for i, sweep in enumerate(self.found.valves):
            yield CalibratedPart(("valves", i, "valve"), ("valve", sweep.valve), f"valve {sweep.valve}")

    def apply(self, draft: Draft) -> None:
        place_of = {sensor.actuator: place for place, sensor in enumerate(draft.sensors) if sensor is not None}
        for i, scale in enumerate(self.found.sensors):
            if scale.actuator in place_of:
                span_bar = [scale.offset_bar + scale.scale_bar_per_V * v for v in scale.span_V]
                draft.put(("sensors", place_of[scale.actuator], "span_bar"), span_bar, self.source, ("sensors", i))
        for i, sweep in enumerate(self.found.valves):
            curve = sweep.model_dump(mode="json", include=set(CALIBRATED_KEYS))
            draft.put(("valves", sweep.valve - 1), curve, self.source, ("valves", i))

    def misfits(self, draft: Draft) -> Problems:
        yield from self._other_sensors(draft)
        yield from self._other_valves(draft)

    def _other_sensors(self, draft: Draft) -> Problems:
        stated = draft.sensors
        sensors = {sensor.actuator: sensor for sensor in stated if sensor is not None}
        for i, scale in enumerate(self.found.sensors):
            path: YamlPath = ("sensors", i)
            if scale.actuator not in sensors:
                if None not in stated:
                    yield self.source.problem((*path, "actuator"), f"an actuator of rig {draft.name}")
                continue
            sensor = sensors[scale.actuator]
            yield from _other_channel(
                draft, self.source, path, scale, sensor, f"the sensor of actuator {scale.actuator}"
            )
            if sensor.unit != "V":
                expected = f"a sensor in volts; that of actuator {scale.actuator} gives {sensor.unit}"
                yield self.source.problem((*path, "actuator"), expected)
            else:
                why = f"as the sensor of rig {draft.name}"
                yield from _unlike(self.source, path, scale, {"span_V": sensor.span_V}, why)

    def _other_valves(self, draft: Draft) -> Problems:
        valves = draft.valves
        for i, sweep in enumerate(self.found.valves):
            path: YamlPath = ("valves", i)
            if sweep.valve > len(valves):
                yield self.source.problem((*path, "valve"), f"a valve from 1 to {len(valves)}")
                continue
            valve = valves[sweep.valve - 1]
            if valve is None:
                continue
            if not isinstance(valve, MeteringValve):
                expected = f"a valve that meters flow; valve {sweep.valve} of rig {draft.name} regulates by itself"
                yield self.source.problem((*path, "valve"), expected)
                continue
            yield from _other_channel(draft, self.source, path, sweep, valve, f"valve {sweep.valve}")
            low_v, high_v = valve.range_V
            if not low_v < sweep.closed_V < high_v:
                expected = f"a voltage inside range_V of the valve, {low_v:g} to {high_v:g} V"
                yield self.source.problem((*path, "closed_V"), expected)


class GravityOverlay(CalibrationOverlay[GravityFile]):
    """The direction of gravity."""

    def subjects(self) -> Iterator[CalibratedPart]:
        yield CalibratedPart(("direction",), ("gravity", ""), "the direction of gravity")

    def apply(self, draft: Draft) -> None:
        draft.put(("arm", "gravity_direction"), list(self.found.direction), self.source, ("direction",))
        draft.put(("uncertainties", "gravity_direction_deg"), self.found.std_deg, self.source, ("std_deg",))


OVERLAYS: dict[type[CalibrationFile], type[CalibrationOverlay[Any]]] = {
    CameraFile: LensOverlay,
    DLTFile: PlacementOverlay,
    ToolFile: BoardOverlay,
    PressureFile: PressureOverlay,
    GravityFile: GravityOverlay,
}


def overlay_of(calibration: LoadedCalibration) -> CalibrationOverlay[Any]:
    """Return the overlay of a file."""
    return OVERLAYS[type(calibration.found)](calibration.source, calibration.found)


def _unlike(source: Document, path: YamlPath, part: Section, stated: Mapping[str, object], why: str) -> Problems:
    """Yield what a part of the file has otherwise than the rig states; lengths on a print are good to a thousandth."""
    for key, wants in stated.items():
        has = getattr(part, key)
        same = (
            math.isclose(has, wants, rel_tol=1e-3)
            if isinstance(has, float) and isinstance(wants, float)
            else has == wants
        )
        if has is not None and not same:
            yield source.problem((*path, key), f"{_short(wants)}, {why}", _short(has))


def _short(value: object) -> str:
    """A value as the YAML has it, a length without needless digits."""
    return f"{value:g}" if isinstance(value, float) else str(list(value) if isinstance(value, tuple) else value)


def _other_camera(draft: Draft, source: Document, path: YamlPath, identity: CameraIdentity) -> Problems:
    names = draft.get("cameras") or {}
    if identity.name not in names:
        expected = f"a camera of rig {draft.name}: {', '.join(map(str, names)) or 'it has none'}"
        yield source.problem((*path, "name"), expected, suggestion=closest(identity.name, map(str, names)))
        return
    if (camera := draft.cameras.get(identity.name)) is None:
        return
    where = f"cameras, {identity.name} of rig {draft.name}"
    for keys, why in (
        ({"width_px", "height_px"}, "a calibration holds at its own resolution only"),
        ({"driver", "device"}, "this is another camera's calibration"),
    ):
        yield from _unlike(source, path, identity, camera.model_dump(include=keys), f"as {where}: {why}")


def _other_channel(
    draft: Draft,
    source: Document,
    path: YamlPath,
    part: SensorCalibration | ValveCalibration,
    stated: Sensor | ValveSection,
    what: str,
) -> Problems:
    if (card := draft.cards.get(stated.card)) is None:
        return
    identity = {"name": stated.card, "driver": card.driver, "device": card.device}
    why = f"the card of {what} in rig {draft.name}: this was measured through another card"
    yield from _unlike(source, (*path, "card"), part.card, identity, why)
    channel = f"the channel of {what} in rig {draft.name}"
    yield from _unlike(source, path, part, {"channel": stated.channel}, channel)
