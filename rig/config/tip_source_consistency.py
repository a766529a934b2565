"""Consistency of what measures the tip: cameras with their triggers, trackers, and the boards of the arm."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, TypeVar

from protocols.problems import closest
from protocols.validation import ValidationFault
from rig.config.drivers import Reality

if TYPE_CHECKING:
    from rig.config.arm_sections import ArmConfig
    from rig.config.board_sections import BoardConfig, MeasuredSection
    from rig.config.card_sections import CardConfig
    from rig.config.sections import CameraConfig, CameraTrigger
    from rig.config.simulator_sections import Simulator
    from rig.config.tracker_sections import TrackerConfig
    from rig.sections.control import Control, Limits

    Cards = Mapping[str, CardConfig | None]
    Cameras = Mapping[str, CameraConfig | None]
    Trackers = Mapping[str, TrackerConfig | None]
    Path = tuple[str | int, ...]

Item = TypeVar("Item")

CENTRE_SHARE = 0.25
"""A principal point farther from the middle of the picture, as a share of its size, belongs to another resolution."""
FOCAL_SHARES = (0.1, 50.0)
"""Focal lengths as shares of the picture's size: views of 157 down to 1.1 degrees."""
WHOLE = 1e-4
"""Relative tolerance for a whole number: 200 / 28.571 is 7."""
LEAST_FRAMES = 4
"""Of `no_tip_s`: no pulse is given for up to two frames before a run begins."""


def valid(items: Mapping[str, Item | None]) -> dict[str, Item]:
    """The items of a section that are valid by themselves."""
    return {name: item for name, item in items.items() if item is not None}


def different_devices(section: str, items: Mapping[str, CardConfig | CameraConfig | None]) -> Iterator[ValidationFault]:
    """Refuse two items of a section with one device."""
    taken: dict[tuple[str, str | int], str] = {}
    for name, item in items.items():
        if item is not None and (first := taken.setdefault((item.driver, item.device), name)) != name:
            yield ValidationFault((section, name, "device"), f"a device of its own: '{first}' has this one")


def check_cameras(cameras: Cameras) -> Iterator[ValidationFault]:
    yield from different_devices("cameras", cameras)
    rates = {name: camera.rate_hz for name, camera in valid(cameras).items()}
    for name, camera in valid(cameras).items():
        path: Path = ("cameras", name)
        first = next(iter(rates))
        if camera.rate_hz != rates[first]:
            yield ValidationFault(
                (*path, "rate_hz"), f"the rate of camera '{first}', {rates[first]:g} Hz: they see together"
            )
        if camera.planar_motion is not None and not any(camera.planar_motion.normal):
            yield ValidationFault((*path, "planar_motion", "normal"), "a direction, such as [0, 1, 0]")
        longest = 1000 / camera.rate_hz
        if camera.exposure_ms > longest:
            yield ValidationFault(
                (*path, "exposure_ms"), f"at most the time between frames, {longest:g} ms at {camera.rate_hz:g} Hz"
            )
        for key, centre, size in (
            ("cx_px", camera.lens.cx_px, camera.width_px),
            ("cy_px", camera.lens.cy_px, camera.height_px),
        ):
            low, high = size * (0.5 - CENTRE_SHARE), size * (0.5 + CENTRE_SHARE)
            if not low <= centre <= high:
                expected = f"a centre near the middle of the picture, {low:g} to {high:g} px of {size} px: "
                expected += "was the lens calibrated at another resolution?"
                yield ValidationFault((*path, "lens", key), expected)
        for key, focal in (("fx_px", camera.lens.fx_px), ("fy_px", camera.lens.fy_px)):
            size = camera.width_px if key == "fx_px" else camera.height_px
            low, high = size * FOCAL_SHARES[0], size * FOCAL_SHARES[1]
            if not low <= focal <= high:
                expected = f"a focal length in pixels, {low:g} to {high:g} px for a picture of {size} px: is it in mm?"
                yield ValidationFault((*path, "lens", key), expected)


def check_least_cameras(cameras: Cameras, limits: Limits) -> Iterator[ValidationFault]:
    if limits.least_cameras > max(1, len(cameras)):
        yield ValidationFault(("limits", "least_cameras"), f"at most {len(cameras)}: so many cameras has this rig")


def check_trackers(cameras: Cameras, trackers: Trackers, limits: Limits) -> Iterator[ValidationFault]:
    if cameras and trackers:
        yield ValidationFault(("trackers",), "no such section in a rig with cameras: one or the other measures the tip")
    for name in tuple(trackers)[1:]:
        yield ValidationFault(("trackers", name), "one tracker at most: the tip is measured by one")
    for name, tracker in valid(trackers).items():
        if limits.no_tip_s < 2 / tracker.rate_hz:
            expected = f"at least two poses of tracker '{name}', {2 / tracker.rate_hz:g} s"
            yield ValidationFault(("limits", "no_tip_s"), expected)
        if tracker.latest_ms < tracker.delay_ms:
            yield ValidationFault(("trackers", name, "latest_ms"), f"more than delay_ms, {tracker.delay_ms:g} ms")


def check_board(cameras: Cameras, board: BoardConfig | None) -> Iterator[ValidationFault]:
    if cameras and board is None:
        yield ValidationFault(("board",), "is missing: the cameras measure the tip by a board on it")
    if board is not None and not cameras:
        yield ValidationFault(("board",), "no such section, because the rig has no camera to see a board")


def check_simulated_cameras(cameras: Cameras, simulator: Simulator | None) -> Iterator[ValidationFault]:
    if simulator is None:
        return
    mocks = [name for name, camera in valid(cameras).items() if camera.reality is Reality.SIMULATED]
    if simulator.scene is None and mocks:
        yield ValidationFault(("simulator", "scene"), f"is missing: what the simulated camera '{mocks[0]}' sees")
    for name in simulator.camera_errors:
        if name not in cameras:
            expected = f"one of the cameras: {', '.join(cameras) or 'the rig has none'}"
            yield ValidationFault(("simulator", "camera_errors", name), expected, closest(name, cameras))
    period_ms = min((1000 / camera.rate_hz for camera in valid(cameras).values()), default=math.inf)
    longest = period_ms / max(1, len(cameras))
    if simulator.scene is not None and simulator.scene.skew_ms > longest:
        expected = f"at most {longest:.4g} ms: all cameras expose within the time between frames"
        yield ValidationFault(("simulator", "scene", "skew_ms"), expected)


def check_triggers(cards: Cards, cameras: Cameras, control: Control, limits: Limits) -> Iterator[ValidationFault]:
    """Yield what is wrong with the triggers; all cameras of a rig are triggered together, or none."""
    triggered = valid(cameras)
    triggers = {name: camera.trigger for name, camera in triggered.items() if camera.trigger is not None}
    if not triggers:
        return
    first, lead = next(iter(triggers.items()))
    for name, camera in triggered.items():
        path: Path = ("cameras", name)
        trigger = camera.trigger
        if trigger is None:
            yield ValidationFault((*path, "trigger"), f"a trigger, because camera '{first}' has one: they see together")
            continue
        yield from _output((*path, "trigger"), trigger, camera, cards)
        yield from _timing(path, trigger, camera, control)
        for key, own, other in (("card", trigger.card, lead.card), ("width_ms", trigger.width_ms, lead.width_ms)):
            if own != other:
                expected = f"that of camera '{first}', {'one control period' if other is None else other}"
                yield ValidationFault((*path, "trigger", key), f"{expected}: one pulse triggers all cameras")
        if limits.no_tip_s < LEAST_FRAMES / camera.rate_hz:
            expected = f"at least {LEAST_FRAMES} frames of the triggered camera '{name}', "
            yield ValidationFault(("limits", "no_tip_s"), f"{expected}{LEAST_FRAMES / camera.rate_hz:g} s")


def _output(path: Path, trigger: CameraTrigger, camera: CameraConfig, cards: Cards) -> Iterator[ValidationFault]:
    """Check that the card has the digital output."""
    if trigger.card not in cards:
        expected = f"one of the cards: {', '.join(cards)}"
        yield ValidationFault((*path, "card"), expected, closest(trigger.card, cards))
        return
    card = cards[trigger.card]
    if card is None:
        return
    if not card.writes_digital:
        expected = f"a card whose driver writes digital outputs: driver {card.driver} writes none"
        yield ValidationFault((*path, "card"), expected)
    elif (camera.reality is Reality.SIMULATED) != (card.reality is Reality.SIMULATED):
        kind = "simulated" if camera.reality is Reality.SIMULATED else "real"
        yield ValidationFault((*path, "card"), f"a {kind} card, because the camera is {kind}")
    elif trigger.channel >= card.digital_outputs:
        count = card.digital_outputs
        expected = "a card with `digital_outputs`" if count == 0 else f"a channel from 0 to {count - 1}"
        yield ValidationFault((*path, "channel"), f"{expected}: card '{trigger.card}' has {count or 'no'} DO channels")


def _timing(path: Path, trigger: CameraTrigger, camera: CameraConfig, control: Control) -> Iterator[ValidationFault]:
    """Check that period and width of the pulses are whole numbers of control periods."""
    cycles = control.rate_hz / camera.rate_hz
    if cycles < 2 - WHOLE:
        expected = f"at most half of control, rate_hz, {control.rate_hz / 2:g} Hz: control gives the trigger pulses"
        yield ValidationFault((*path, "rate_hz"), expected)
        return
    if abs(cycles - round(cycles)) > WHOLE * cycles:
        near = " or ".join(f"{control.rate_hz / n:.6g}" for n in (int(cycles) + 1, int(cycles)) if n >= 2)
        expected = f"a rate that divides control, rate_hz, such as {near} Hz: control gives the trigger pulses"
        yield ValidationFault((*path, "rate_hz"), expected)
        return
    if trigger.width_ms is None:
        return
    period_ms, width = 1e3 / control.rate_hz, trigger.width_ms * 1e-3 * control.rate_hz
    if round(width) < 1 or abs(width - round(width)) > WHOLE * width or round(width) >= round(cycles):
        longest = (round(cycles) - 1) * period_ms
        expected = f"whole control periods of {period_ms:g} ms, at most {longest:g} ms: less than a frame period"
        yield ValidationFault((*path, "trigger", "width_ms"), expected)


def check_sections(
    board: BoardConfig | None, sections: Mapping[str, MeasuredSection | None], arm: ArmConfig
) -> Iterator[ValidationFault]:
    """Yield what is wrong with the sections: the boards of a rig have different markers."""
    stated = valid(sections)
    if not stated:
        return
    if board is None:
        yield ValidationFault(("sections",), "no such section in a rig without a board on the end cap")
        return
    boards: dict[tuple[str | int, ...], BoardConfig] = {("board",): board}
    length_mm, places = arm.length_mm, dict[float, str]()
    for name, section in stated.items():
        if section.at_mm >= length_mm:
            expected = f"less than the length of the arm, {length_mm:g} mm"
            yield ValidationFault(("sections", name, "at_mm"), expected)
        if (taken_by := places.setdefault(section.at_mm, name)) != name:
            expected = f"another place: section {taken_by} is there too; two boards on one section measure the same"
            yield ValidationFault(("sections", name, "at_mm"), expected)
        boards["sections", name, "board"] = section.board
    seen: list[tuple[str, BoardConfig]] = []
    for path, one in boards.items():
        family, numbers = one.markers
        if not numbers:
            expected = "charuco or apriltag: markers distinguish several boards"
            yield ValidationFault((*path, "kind"), expected)
            continue
        for other_name, other in seen:
            other_family, others = other.markers
            if family == other_family and max(numbers[0], others[0]) <= min(numbers[-1], others[-1]):
                expected = f"markers of its own: {other_name} has numbers {others[0]} to {others[-1]} of {family}"
                yield ValidationFault((*path, "first_marker"), expected)
                break
        seen.append((", ".join(map(str, path)), one))
