"""Overlay of calibration files on a rig's YAML: calibrated values replace the stated ones.

The simulator keeps the values that the rig stated before, under `simulator, built`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from protocols import BadInputError, Problem
from protocols.document import Document
from protocols.problems import closest
from rig.config.calibration_files import LoadedCalibration, read
from rig.config.calibration_schema import (
    CameraFile,
    CameraIdentity,
    CardIdentity,
    DLTFile,
    PressureFile,
    SensorCalibration,
    ToolFile,
    ValveCalibration,
)
from rig.config.optics import placement_of, rigid
from rig.config.schema import RigConfig
from rig.config.sections import Placement, Sensor
from rig.valves.base import ValveSection
from rig.valves.flow import FlowValve

Faults = Iterator[Problem]


def read_all(source: Document) -> tuple[tuple[str, LoadedCalibration], ...]:
    """Read every calibration file that a rig's YAML names, relative to its folder; return each with its name there.

    Raises:
        BadInputError: the problems of all files.
    """
    found: list[tuple[str, LoadedCalibration]] = []
    problems: list[Problem] = []
    for i, name in enumerate(source.data.get("calibrations") or ()):
        path = Path(source.file).parent / str(name)
        try:
            found.append((str(name), read(path)))
        except BadInputError as bad:
            mark = source.position(("calibrations", i))
            if path.is_file():
                problems += bad.problems
            else:
                expected = "a calibration file: this file does not exist in the rig's folder"
                problems.append(Problem(source.file, mark.line, mark.column, "calibrations", mark.source, expected))
    problems += _twice([one for _, one in found])
    if problems:
        raise BadInputError(problems)
    return tuple(found)


def read_files(paths: Sequence[Path]) -> tuple[tuple[str, LoadedCalibration], ...]:
    """Read calibration files; return each with its name. `BadInputError` has the problems of all of them."""
    found: list[tuple[str, LoadedCalibration]] = []
    problems: list[Problem] = []
    for path in paths:
        try:
            found.append((path.name, read(path)))
        except BadInputError as bad:
            problems += bad.problems
    problems += _twice([one for _, one in found])
    if problems:
        raise BadInputError(problems)
    return tuple(found)


def not_replaced(
    known: Sequence[tuple[str, LoadedCalibration]], newer: Sequence[LoadedCalibration]
) -> tuple[tuple[str, LoadedCalibration], ...]:
    """Return the calibrations that have a subject which no newer one has."""
    replaced = {key for one in newer for _, key, _ in _subjects(one)}
    return tuple((name, one) for name, one in known if {key for _, key, _ in _subjects(one)} - replaced)


def check_serials(config: RigConfig, calibrations: Sequence[LoadedCalibration]) -> None:
    """Refuse calibrations of cameras with another serial number than those that are plugged in.

    Raises:
        BadInputError: every camera that has another serial number.
    """
    from rig.hardware.cameras.registry import serial_of

    problems = []
    for calibration in calibrations:
        for here, identity in _cameras(calibration):
            serial = serial_of(config.cameras[identity.name]) if identity.serial is not None else None
            if serial is not None and serial != identity.serial:
                where = f"cameras, {identity.name} of rig {config.name}"
                expected = f"{serial}, the serial number of the camera that is plugged in for {where}"
                problems.append(calibration.problem((*here, "serial"), identity.serial, expected))
    if problems:
        raise BadInputError(problems)


def _cameras(calibration: LoadedCalibration) -> Iterator[tuple[tuple[str | int, ...], CameraIdentity]]:
    """Yield the cameras that a calibration is for, with their YAML paths."""
    found = calibration.found
    if isinstance(found, DLTFile):
        for i, item in enumerate(found.cameras):
            yield ("cameras", i, "camera"), item.camera
    elif isinstance(found, CameraFile | ToolFile):
        yield ("camera",), found.camera


def with_calibrations(text: str, config: RigConfig, calibrations: Sequence[LoadedCalibration]) -> str:
    """Return the rig's YAML `text` with the calibrations applied in order; `config` is its parsed form.

    Raises:
        BadInputError: a calibration has another camera, resolution, board or card.
    """
    problems: list[Problem] = []
    for calibration in calibrations:
        problems += _unfit(config, calibration)
        problems += _other_lens(config, calibration, calibrations)
    if problems:
        raise BadInputError(problems)
    data = yaml.safe_load(text)
    data.pop("calibrations", None)
    built = None if config.simulator is None else as_stated(config)
    for calibration in calibrations:
        found = calibration.found
        if isinstance(found, CameraFile):
            data["cameras"][found.camera.name]["lens"] = found.lens.model_dump(mode="json")
        elif isinstance(found, DLTFile):
            for camera in found.cameras:
                _place_camera(data, config, camera.camera.name, camera.placement)
        elif isinstance(found, ToolFile):
            data["board"]["placement"] = found.placement.model_dump(mode="json")
        else:
            _scale_sensors(data, found.sensors)
            _shape_valves(data, found.valves)
    if built is not None:
        data["simulator"]["built"] = {**built, **data["simulator"].get("built", {})}
    if built is not None and config.board is not None:
        data["simulator"].setdefault("board", config.board.placement.model_dump(mode="json"))
    head = "".join(f"# with {Path(c.source.file).name}, sha256 {c.sha256}\n" for c in calibrations)
    return head + yaml.safe_dump(data, sort_keys=False, width=120, default_flow_style=None)


def as_stated(config: RigConfig) -> dict[str, Any]:
    """Return the stated lenses, valves and sensors, from which the simulator is built."""
    return {
        "lenses": {name: camera.lens.model_dump(mode="json") for name, camera in config.cameras.items()},
        "valves": [valve.model_dump(mode="json") for valve in config.valves],
        "sensors": [sensor.model_dump(mode="json") for sensor in config.sensors],
    }


def _place_camera(data: dict[str, Any], config: RigConfig, name: str, found: Placement) -> None:
    if config.simulator is not None:
        # The true camera pose stays: the stated placement changes, so the simulated error absorbs the difference.
        stands = rigid(config.cameras[name].placement) @ rigid(config.simulator.error_of(name))
        errors = data["simulator"].setdefault("camera_errors", {})
        errors[name] = placement_of(rigid(found).inverse() @ stands).model_dump(mode="json")
    data["cameras"][name]["placement"] = found.model_dump(mode="json")


def _scale_sensors(data: dict[str, Any], scales: Sequence[SensorCalibration]) -> None:
    for scale in scales:
        for sensor in data["sensors"]:
            if int(sensor["actuator"]) == scale.actuator:
                sensor["span_V"] = list(scale.span_V)
                sensor["span_bar"] = [scale.offset_bar + scale.scale_bar_per_V * v for v in scale.span_V]


def _shape_valves(data: dict[str, Any], sweeps: Sequence[ValveCalibration]) -> None:
    for sweep in sweeps:
        data["valves"][sweep.valve - 1] |= {
            "closed_V": sweep.closed_V,
            "dead_zone_V": sweep.dead_zone_V,
            "full_flow_l_min": sweep.full_flow_l_min,
            "flow_curve_V": list(sweep.flow_curve_V),
            "flow_curve_percent": list(sweep.flow_curve_percent),
        }


def _twice(calibrations: Sequence[LoadedCalibration]) -> Faults:
    taken: dict[tuple[str, object], str] = {}
    for calibration in calibrations:
        for path, key, subject in _subjects(calibration):
            if key in taken:
                expected = f"each thing calibrated by one file: {subject} is in {taken[key]}, too"
                yield calibration.problem(path, calibration.source.position(path).source, expected)
            taken.setdefault(key, calibration.source.file)


def _subjects(calibration: LoadedCalibration) -> Iterator[tuple[tuple[str | int, ...], tuple[str, object], str]]:
    """Yield each subject of a file: its YAML path, a unique key, a description."""
    found = calibration.found
    if isinstance(found, CameraFile):
        yield ("camera", "name"), ("lens", found.camera.name), f"the lens of camera '{found.camera.name}'"
    elif isinstance(found, DLTFile):
        for i, item in enumerate(found.cameras):
            name = item.camera.name
            yield ("cameras", i, "camera", "name"), ("place", name), f"the place of camera '{name}'"
    elif isinstance(found, ToolFile):
        yield ("kind",), ("tool", ""), "the board on the tip"
    else:
        for i, scale in enumerate(found.sensors):
            yield ("sensors", i, "actuator"), ("sensor", scale.actuator), f"the sensor of actuator {scale.actuator}"
        for i, sweep in enumerate(found.valves):
            yield ("valves", i, "valve"), ("valve", sweep.valve), f"valve {sweep.valve}"


def _unfit(config: RigConfig, calibration: LoadedCalibration) -> Faults:
    """Yield the reasons why a calibration does not belong to the rig."""
    found = calibration.found
    for here, camera in _cameras(calibration):
        yield from _other_camera(config, calibration, here, camera)
    if isinstance(found, DLTFile):
        if found.world != "rod base":
            expected = "rod base: the rig's cameras stand in that frame; calibrate with control points in it, or --base"
            yield calibration.problem(("world",), found.world, expected)
    elif isinstance(found, ToolFile) and config.board is None:
        yield calibration.problem(("board",), "a board", f"no calibration of a tool: rig {config.name} has no board")
    elif isinstance(found, ToolFile) and config.board is not None:
        have = (config.board.squares_x - 1, config.board.squares_y - 1)
        if tuple(found.board.corners) != have:
            expected = f"{have[0]}x{have[1]} inner corners, as the board of rig {config.name}"
            yield calibration.problem(("board", "corners"), "x".join(map(str, found.board.corners)), expected)
        if abs(found.board.square_mm - config.board.square_mm) > 1e-3 * config.board.square_mm:
            expected = f"{config.board.square_mm:g}, as the board of rig {config.name}"
            yield calibration.problem(("board", "square_mm"), found.board.square_mm, expected)
    elif isinstance(found, PressureFile):
        yield from _other_bench(config, calibration, found)


def _other_camera(
    config: RigConfig, calibration: LoadedCalibration, here: tuple[str | int, ...], identity: CameraIdentity
) -> Faults:
    if identity.name not in config.cameras:
        known = ", ".join(config.cameras) or "it has none"
        expected = f"a camera of rig {config.name}: {known}"
        problem = calibration.problem((*here, "name"), identity.name, expected)
        yield Problem(**{**problem.__dict__, "suggestion": closest(identity.name, config.cameras)})
        return
    camera = config.cameras[identity.name]
    where = f"cameras, {identity.name} of rig {config.name}"
    for key in ("width_px", "height_px"):
        has, wants = getattr(identity, key), getattr(camera, key)
        if has != wants:
            expected = f"{wants}, as {where}: a calibration holds at its own resolution only"
            yield calibration.problem((*here, key), has, expected)
    for key in ("driver", "device"):
        has, wants = getattr(identity, key), getattr(camera, key)
        if has is not None and has != wants:
            yield calibration.problem((*here, key), has, f"{wants}, as {where}: this is another camera's calibration")


def _other_lens(config: RigConfig, calibration: LoadedCalibration, calibrations: Sequence[LoadedCalibration]) -> Faults:
    """A camera placement is valid only with the lens that it was calibrated with."""
    found = calibration.found
    if not isinstance(found, DLTFile):
        return
    lenses = {c.found.camera.name: c.found.lens for c in calibrations if isinstance(c.found, CameraFile)}
    for i, item in enumerate(found.cameras):
        name = item.camera.name
        if item.lens is None or name not in config.cameras:
            continue
        used = lenses.get(name, config.cameras[name].lens)
        mine, theirs = (np.array([v.fx_px, v.fy_px, v.cx_px, v.cy_px, *v.distortion]) for v in (item.lens, used))
        if not np.allclose(mine, theirs, rtol=1e-5, atol=1e-7):
            expected = f"{used.fx_px:g} and so on, the lens of camera {name} in rig {config.name}: the place was found "
            expected += "through another lens; name that lens's calibration, too"
            yield calibration.problem(("cameras", i, "lens"), f"fx_px {item.lens.fx_px:g}", expected)


def _other_bench(config: RigConfig, calibration: LoadedCalibration, found: PressureFile) -> Faults:
    sensors = {s.actuator: s for s in config.sensors}
    for i, scale in enumerate(found.sensors):
        here: tuple[str | int, ...] = ("sensors", i)
        if scale.actuator not in sensors:
            yield calibration.problem((*here, "actuator"), scale.actuator, f"an actuator of rig {config.name}")
            continue
        sensor = sensors[scale.actuator]
        yield from _other_channel(config, calibration, here, scale, sensor, f"the sensor of actuator {scale.actuator}")
        if sensor.unit != "V":
            expected = f"a sensor in volts; that of actuator {scale.actuator} gives {sensor.unit}"
            yield calibration.problem((*here, "actuator"), scale.actuator, expected)
        elif tuple(scale.span_V) != tuple(sensor.span_V):
            expected = f"{list(sensor.span_V)}, as the sensor of rig {config.name}"
            yield calibration.problem((*here, "span_V"), list(scale.span_V), expected)
    for i, sweep in enumerate(found.valves):
        here = ("valves", i)
        if sweep.valve > len(config.valves):
            yield calibration.problem((*here, "valve"), sweep.valve, f"a valve from 1 to {len(config.valves)}")
            continue
        valve = config.valves[sweep.valve - 1]
        if not isinstance(valve, FlowValve):
            expected = f"a valve that meters flow; valve {sweep.valve} of rig {config.name} regulates by itself"
            yield calibration.problem((*here, "valve"), sweep.valve, expected)
            continue
        yield from _other_channel(config, calibration, here, sweep, valve, f"valve {sweep.valve}")
        if not valve.range_V[0] < sweep.closed_V < valve.range_V[1]:
            expected = f"a voltage inside range_V of the valve, {valve.range_V[0]:g} to {valve.range_V[1]:g} V"
            yield calibration.problem((*here, "closed_V"), sweep.closed_V, expected)


def _other_channel(
    config: RigConfig,
    calibration: LoadedCalibration,
    here: tuple[str | int, ...],
    part: SensorCalibration | ValveCalibration,
    stated: Sensor | ValveSection,
    what: str,
) -> Faults:
    card = config.cards[stated.card]
    identity = CardIdentity(name=stated.card, driver=card.driver, device=card.device)
    for key in ("name", "driver", "device"):
        has, wants = getattr(part.card, key), getattr(identity, key)
        if has != wants:
            expected = f"{wants}, the card of {what} in rig {config.name}: this was measured through another card"
            yield calibration.problem((*here, "card", key), has, expected)
    if part.channel != stated.channel:
        expected = f"{stated.channel}, the channel of {what} in rig {config.name}"
        yield calibration.problem((*here, "channel"), part.channel, expected)
