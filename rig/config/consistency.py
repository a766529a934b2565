"""Consistency checks between the sections of a rig's YAML, each of which is valid by itself.

An invalid section is passed as None, so that one mistyped number hides no other fault.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar, get_args

from protocols.problems import closest
from protocols.source_positions import path_text
from protocols.validation import ValidationFault
from rig.config import tip_source_consistency as tip_sources
from rig.config.drivers import Reality
from rig.config.sections import Sensor
from rig.valves.registry import VALVES

if TYPE_CHECKING:
    from rig.config.arm_sections import ArmConfig, GeometryConfig
    from rig.config.card_sections import CardConfig
    from rig.config.input_sections import AuxiliaryInput, EmergencyStop
    from rig.config.sections import CameraConfig
    from rig.config.simulator_sections import Simulator
    from rig.config.tracker_sections import TrackerConfig
    from rig.sections.control import Control, Limits
    from rig.valves.base import ValveSection

    Cards = Mapping[str, CardConfig | None]
    Inputs = Mapping[str, AuxiliaryInput | None]
    Cameras = Mapping[str, CameraConfig | None]
    Trackers = Mapping[str, TrackerConfig | None]
    Valves = Sequence[ValveSection | None]
    Sensors = Sequence[Sensor | None]


def check(parts: Mapping[str, Any]) -> list[ValidationFault]:
    """Return every inconsistency; `parts` are the present fields of `RigConfig`."""
    checks: tuple[tuple[Callable[..., Iterator[ValidationFault]], tuple[str, ...]], ...] = (
        (_valve_channels, ("cards", "valves")),
        (_input_channels, ("cards", "sensors", "inputs")),
        (_stop_channels, ("cards", "emergency_stops")),
        (check_units, ("cards", "valves", "sensors", "inputs")),
        (_input_values, ("inputs", "control", "simulator")),
        (_actuators, ("arm", "valves", "sensors")),
        (_valves, ("valves",)),
        (_sensors, ("sensors",)),
        (_reach, ("limits", "valves", "sensors")),
        (_rates, ("cards", "cameras", "control", "limits")),
        (_cards, ("cards",)),
        (tip_sources.check_cameras, ("cameras",)),
        (tip_sources.check_triggers, ("cards", "cameras", "control", "limits")),
        (tip_sources.check_least_cameras, ("cameras", "limits")),
        (tip_sources.check_board, ("cameras", "board")),
        (tip_sources.check_sections, ("board", "sections", "arm")),
        (tip_sources.check_trackers, ("cameras", "trackers", "limits")),
        (_arm, ("arm",)),
        (_simulator, ("cards", "cameras", "trackers", "simulator")),
        (_simulated_parts, ("valves", "sensors", "simulator")),
        (tip_sources.check_simulated_cameras, ("cameras", "simulator")),
        (_simulated_arm, ("arm", "simulator")),
    )
    return [
        fault
        for function, names in checks
        if all(name in parts for name in names)
        for fault in function(*(parts[name] for name in names))
    ]


Item = TypeVar("Item")


def _numbered(items: Sequence[Item | None]) -> list[tuple[int, Item]]:
    return [(index, item) for index, item in enumerate(items) if item is not None]


ChannelUser = tuple[tuple[str | int, ...], str, Any]
"""What uses a channel of a card: its place in the file, its name for messages, and its section."""


def _listed(key: str, items: Sequence[Any]) -> list[ChannelUser]:
    return [((key, index), f"{key} #{index + 1}", item) for index, item in _numbered(items)]


def _by_name(key: str, items: Mapping[str, Any]) -> list[ChannelUser]:
    return [((key, name), f"{key}, {name}", item) for name, item in tip_sources.valid(items).items()]


def _channels(
    cards: Cards, users: Sequence[ChannelUser], kind: str, have: Callable[[CardConfig], int]
) -> Iterator[ValidationFault]:
    taken: dict[tuple[str, int], str] = {}
    for path, name, user in users:
        if user.card not in cards:
            yield ValidationFault((*path, "card"), f"one of the cards: {', '.join(cards)}", closest(user.card, cards))
            continue
        card = cards[user.card]
        if card is not None and user.channel >= have(card):
            count, wanted = have(card), sum(other.card == user.card for _, _, other in users)
            expected = {0: "another card", 1: "channel 0"}.get(count, f"a channel from 0 to {count - 1}")
            expected += f": card '{user.card}' has {count or 'no'} {kind} channel{'' if count == 1 else 's'}"
            if wanted > count:
                expected += f", and this rig needs {wanted}"
            yield ValidationFault((*path, "channel"), expected)
        elif (user.card, user.channel) in taken:
            first = taken[user.card, user.channel]
            yield ValidationFault((*path, "channel"), f"a channel of its own: {first} has this one")
        else:
            taken[user.card, user.channel] = name


def _valve_channels(cards: Cards, valves: Valves) -> Iterator[ValidationFault]:
    yield from _channels(cards, _listed("valves", valves), "AO", lambda card: card.outputs)


def _input_channels(cards: Cards, sensors: Sensors, inputs: Inputs) -> Iterator[ValidationFault]:
    users = [*_listed("sensors", sensors), *_by_name("inputs", inputs)]
    yield from _channels(cards, users, "AI", lambda card: card.inputs)


def _stop_channels(cards: Cards, stops: Mapping[str, EmergencyStop | None]) -> Iterator[ValidationFault]:
    yield from _channels(cards, _by_name("emergency_stops", stops), "DI", lambda card: card.digital_inputs)


def check_units(cards: Cards, valves: Valves, sensors: Sensors, inputs: Inputs) -> Iterator[ValidationFault]:
    """Yield a fault for each number that the card would take or give in another unit."""
    types = {f"`type: {name}`": kind.output_unit for name, kind in ((name, VALVES[name]) for name in VALVES.built_in)}
    units = {f"`unit: {unit}`": unit for unit in get_args(Sensor.model_fields["unit"].annotation)}
    users = [((*path, "type"), user.card, user.output_unit, types) for path, _, user in _listed("valves", valves)]
    users += [((*path, "unit"), user.card, user.unit, units) for path, _, user in _listed("sensors", sensors)]
    users += [((*path, "card"), user.card, "V", {}) for path, _, user in _by_name("inputs", inputs)]
    for path, name, unit, choices in users:
        card = cards.get(name)
        if card is None or card.signal_units is None or unit in card.signal_units:
            continue
        of_card = " or ".join(card.signal_units)
        fitting = [choice for choice, own in choices.items() if own in card.signal_units]
        expected = " or ".join(fitting) or f"a card with signals in {unit}"
        if fitting and choices is types:
            expected += f" (output in {of_card})"
        expected += f": card '{name}' ({card.driver}) has no signals in {unit}"
        if choices and not fitting:
            known = " or ".join(dict.fromkeys(choices.values()))
            expected += f"; its driver converts {of_card} to {known} (signal_units)"
        yield ValidationFault(path, expected)


def _input_values(inputs: Inputs, control: Control, simulator: Simulator | None) -> Iterator[ValidationFault]:
    for name, one in tip_sources.valid(inputs).items():
        if one.rate_hz is not None and one.rate_hz > control.rate_hz:
            yield ValidationFault(("inputs", name, "rate_hz"), f"at most control, rate_hz, {control.rate_hz:g} Hz")
        if one.tip_force_direction is not None and one.unit != "N":
            yield ValidationFault(("inputs", name, "unit"), "N, because the input has a tip_force_direction")
    yield from _spans(_by_name("inputs", inputs))
    for name in simulator.inputs if simulator is not None else ():
        if name not in inputs:
            expected = f"one of the inputs: {', '.join(inputs) or 'the rig has none'}"
            yield ValidationFault(("simulator", "inputs", name), expected, closest(name, inputs))


def _actuators(arm: ArmConfig, valves: Valves, sensors: Sensors) -> Iterator[ValidationFault]:
    """Check that every actuator has one valve and one sensor."""
    count = arm.actuators
    stated = "(arm, geometry, actuator_angles_deg)" if arm.segments is None else "in its segments"
    drives: list[tuple[int, tuple[str | int, ...]]] = [
        (number, ("valves", i, "actuators", j))
        for i, valve in _numbered(valves)
        for j, number in enumerate(valve.actuators)
    ]
    senses: list[tuple[int, tuple[str | int, ...]]] = [
        (sensor.actuator, ("sensors", i, "actuator")) for i, sensor in _numbered(sensors)
    ]
    for users, one, all_of in ((drives, "valve", "valves"), (senses, "sensor", "sensors")):
        seen: set[int] = set()
        for number, path in users:
            if number > count:
                yield ValidationFault(path, f"an actuator from 1 to {count}: the arm has {count} {stated}")
            elif number in seen:
                yield ValidationFault(path, f"each actuator with one {one}: actuator {number} has one already")
            seen.add(number)
        complete = None not in (valves if one == "valve" else sensors)
        for number in sorted(set(range(1, count + 1)) - seen) if complete else ():
            yield ValidationFault((all_of,), f"a {one} for every actuator: actuator {number} has none")


def _valves(valves: Valves) -> Iterator[ValidationFault]:
    for index, valve in _numbered(valves):
        if valve.safe_state == "hold" and valve.closed_output is None:
            reason = f"vent: a valve of type {valve.type} has no closed position that holds the pressure"
            yield ValidationFault(("valves", index, "safe_state"), reason)
        yield from _below(("valves", index), valve.faults())


def _below(path: tuple[str | int, ...], faults: Iterable[ValidationFault]) -> Iterator[ValidationFault]:
    """Move faults of a section to its place in the file."""
    for fault in faults:
        yield replace(fault, path=(*path, *fault.path))


def _sensors(sensors: Sensors) -> Iterator[ValidationFault]:
    yield from _spans(_listed("sensors", sensors))


def _spans(users: Sequence[ChannelUser]) -> Iterator[ValidationFault]:
    """Check that what an input takes for its span is inside its range."""
    for path, _, user in users:
        low, high = user.range_V
        if user.span_V[0] < low or user.span_V[1] > high:
            yield ValidationFault((*path, "span_V"), f"a span inside range_V, {low:g} to {high:g} V")


def _reach(limits: Limits, valves: Valves, sensors: Sensors) -> Iterator[ValidationFault]:
    """Check that valves and sensors cover the permitted pressures."""
    for index, valve in _numbered(valves):
        yield from _below(("valves", index), valve.reach_faults(limits))
    margin = limits.pressure_margin_bar
    highest, lowest = limits.pressure_bar + margin, limits.lowest_pressure_bar
    # A calibrated span may start slightly above 0; lower pressures read as its lower end.
    bottom, words = (margin, "0") if lowest == 0 else (lowest - margin, f"{lowest - margin:g}")
    for index, sensor in _numbered(sensors):
        if not sensor.span_bar[0] <= bottom < highest <= sensor.span_bar[1]:
            expected = f"a span from {words} to the limit with its margin ({highest:g} bar) at least"
            yield ValidationFault(("sensors", index, "span_bar"), expected)


def _rates(cards: Cards, cameras: Cameras, control: Control, limits: Limits) -> Iterator[ValidationFault]:
    for name, card in tip_sources.valid(cards).items():
        if card.sampling_hz < control.rate_hz:
            expected = f"at least control, rate_hz ({control.rate_hz:g} Hz): each control step needs a sample"
            yield ValidationFault(("cards", name, "sampling_hz"), expected)
    if control.bandwidth_hz > control.rate_hz / 4:
        yield ValidationFault(("control", "bandwidth_hz"), f"at most a quarter of rate_hz, {control.rate_hz / 4:g} Hz")
    if limits.stale_s < 2 / control.rate_hz:
        yield ValidationFault(("limits", "stale_s"), f"at least two control steps, {2 / control.rate_hz:g} s")
    if limits.hung_s is not None and limits.hung_s < 3 / control.rate_hz:
        yield ValidationFault(("limits", "hung_s"), f"at least three control steps, {3 / control.rate_hz:g} s")
    for name, camera in tip_sources.valid(cameras).items():
        if limits.no_tip_s < 2 / camera.rate_hz:
            yield ValidationFault(
                ("limits", "no_tip_s"), f"at least two frames of camera '{name}', {2 / camera.rate_hz:g} s"
            )


def _cards(cards: Cards) -> Iterator[ValidationFault]:
    yield from tip_sources.different_devices("cards", cards)


def _arm(arm: ArmConfig) -> Iterator[ValidationFault]:
    for k, segment in enumerate(arm.chain):
        yield from _below(("arm", *arm.path(k), "geometry"), _geometry(segment.geometry))
    if not any(arm.gravity_direction):
        yield ValidationFault(
            ("arm", "gravity_direction"), "a direction, such as [0, 0, 1]; for no weight set the masses to 0"
        )


def _geometry(geometry: GeometryConfig) -> Iterator[ValidationFault]:
    if geometry.inner_radius_mm >= geometry.outer_radius_mm:
        yield ValidationFault(("inner_radius_mm",), f"less than outer_radius_mm, {geometry.outer_radius_mm:g} mm")
    if geometry.length_mm < 2 * geometry.outer_radius_mm:
        expected = f"at least the diameter of a tube, {2 * geometry.outer_radius_mm:g} mm: is it in millimetres?"
        yield ValidationFault(("length_mm",), expected)
    for (i, a), (j, b) in itertools.combinations(enumerate(geometry.actuator_angles_deg), 2):
        apart = 2 * geometry.circle_radius_mm * abs(math.sin(math.radians(a - b) / 2))
        if apart < 2 * geometry.outer_radius_mm * (1 - 1e-6):
            expected = f"room for the tubes: actuators {i + 1} and {j + 1} are {apart:.3g} mm apart, "
            yield ValidationFault(("actuator_angles_deg", j), expected + "less than 2 outer_radius_mm")


def _simulator(
    cards: Cards, cameras: Cameras, trackers: Trackers, simulator: Simulator | None
) -> Iterator[ValidationFault]:
    mocks = [f"cards, {name}" for name, card in tip_sources.valid(cards).items() if card.reality is Reality.SIMULATED]
    mocks += [
        f"cameras, {name}" for name, camera in tip_sources.valid(cameras).items() if camera.reality is Reality.SIMULATED
    ]
    mocks += [
        f"trackers, {name}"
        for name, tracker in tip_sources.valid(trackers).items()
        if tracker.reality is Reality.SIMULATED
    ]
    if mocks and simulator is None:
        yield ValidationFault(
            ("simulator",), f"is missing: a mock device ({mocks[0]}) needs the block that says what it simulates"
        )
    if simulator is not None and not mocks and None not in (*cards.values(), *cameras.values(), *trackers.values()):
        yield ValidationFault(("simulator",), "no such block, because no device of this rig is a mock")


def _simulated_parts(valves: Valves, sensors: Sensors, simulator: Simulator | None) -> Iterator[ValidationFault]:
    """Check the true valves and sensors against the stated ones, or those that a calibration replaced."""
    if simulator is None:
        return
    built = simulator.built
    if built is not None:
        for key, true, stated in (("valves", built.valves, valves), ("sensors", built.sensors, sensors)):
            if len(true) != len(stated):
                yield ValidationFault(("simulator", "built", key), f"{len(stated)} of them, as many as {key} has")
    found = (
        fault
        for _, valve in _numbered(valves if built is None else built.valves)
        for fault in _below(("simulator", "valve"), valve.simulated_faults(simulator.valve))
    )
    yield from dict.fromkeys(found)
    spans = [s.span_bar[1] - s.span_bar[0] for _, s in _numbered(sensors if built is None else built.sensors)]
    for key, value in (("noise_bar", simulator.sensor.noise_bar), ("offset_bar", simulator.sensor.offset_bar)):
        if spans and value > min(spans):
            yield ValidationFault(("simulator", "sensor", key), f"at most the sensors' span_bar, {min(spans):g} bar")


def _simulated_arm(arm: ArmConfig, simulator: Simulator | None) -> Iterator[ValidationFault]:
    if simulator is None:
        return
    for index, effect in _numbered(simulator.arm_effects):
        yield from _below(("simulator", "arm_effects", index), effect.actuator_faults(arm.actuators))
    if len(simulator.chain) != len(arm.chain):
        key = "material" if simulator.segments is None else "segments"
        expected = f"{len(arm.chain)} `segments`, as many as the arm has"
        if arm.segments is None:
            expected = "`material` in place of `segments`: the arm has one segment"
        yield ValidationFault(("simulator", key), expected)
        return
    for k, (true, stated) in enumerate(zip(simulator.chain, arm.chain, strict=True)):
        if true.geometry is None:
            continue
        path = ("simulator", *simulator.path(k), "geometry")
        yield from _below(path, _geometry(true.geometry))
        if len(true.geometry.actuator_angles_deg) != (count := len(stated.geometry.actuator_angles_deg)):
            place = path_text(("arm", *arm.path(k), "geometry", "actuator_angles_deg"))
            expected = f"{count} angles, as many as {place} has"
            yield ValidationFault((*path, "actuator_angles_deg"), expected)
