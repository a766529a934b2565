"""Reads from a rig file only what `rig vent` needs: cards, valves, what triggers cameras, and sensors to confirm it.

No other part of the file is judged, and a card or valve that is invalid does not hide the others.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from protocols import BadInputError, Problem, document
from protocols.problems import closest
from protocols.source_positions import Document
from rig.config.bench import VentedBench
from rig.config.card_sections import AnyCard
from rig.config.sections import CameraTrigger, Sensor
from rig.sections.quantities import Name
from rig.valves.registry import Valve

_KEYS = ("name", "cards", "valves", "sensors", "cameras")
_NEEDED = ("cards", "valves")


def read(path: Path) -> tuple[VentedBench | None, tuple[Problem, ...]]:
    """The valves of a rig file that can be vented, None if there is none, and every problem of cards and valves.

    Raises:
        BadInputError: the file cannot be read, or its cards and valves are no YAML.
    """
    text = document.read_text(path, document.LARGEST_FILE)
    try:
        source = document.parse(text, str(path))
    except BadInputError as bad:
        try:
            source = document.parse(_top_level_blocks(text), str(path))
        except BadInputError:
            raise bad from None
    return _bench(source, path.stem)


def _top_level_blocks(text: str) -> str:
    """The text with an empty line for each one that belongs to another top-level key than those in `_KEYS`."""
    lines, kept = [], False
    for line in text.split("\n"):
        if re.match(r"[^\s#-]", line):
            kept = re.split(r"[:\s]", line, maxsplit=1)[0] in _KEYS
        lines.append(line if kept else "")
    return "\n".join(lines)


def _bench(source: Document, stem: str) -> tuple[VentedBench | None, tuple[Problem, ...]]:
    problems = [p for p in source.problems if re.split(r"[, ]", p.where, maxsplit=1)[0] in _NEEDED]
    data: dict[str, Any] = {key: source.data[key] for key in _NEEDED if key in source.data}
    names = (source.data.get("name"), stem, "unnamed")
    data["name"] = next(name for _, name in _valid_items(Name, list(names)))
    try:
        document.validate(VentedBench, replace(source, data=data, problems=tuple(problems)))
    except BadInputError as bad:
        problems = list(bad.problems)
    cards = {name: card for name, card in _valid_items(AnyCard, source.data.get("cards")) if isinstance(name, str)}
    valves = []
    for index, valve in _valid_items(Valve, source.data.get("valves")):
        path = ("valves", index)
        if valve.card not in cards:
            if valve.card not in (source.data.get("cards") or ()):
                expected = f"one of the cards: {', '.join(cards)}"
                problems.append(source.problem((*path, "card"), expected, None, closest(valve.card, cards)))
        elif valve.channel >= (count := cards[valve.card].outputs):
            expected = f"a channel below {count}: card '{valve.card}' has {count} outputs"
            problems.append(source.problem((*path, "channel"), expected))
        else:
            valves.append(valve)
    triggers = []
    for camera, found in _mapping(source.data.get("cameras")):
        if not isinstance(found, dict) or found.get("trigger") is None:
            continue
        ((_, trigger),) = tuple(_valid_items(CameraTrigger, [found["trigger"]])) or ((0, None),)
        if trigger is None or trigger.card not in cards:
            expected = "a card and a channel: this output cannot be set low"
            problems.append(source.problem(("cameras", camera, "trigger"), expected))
        else:
            triggers.append(trigger)
    if not valves:
        return None, tuple(problems)
    sensors = [sensor for _, sensor in _valid_items(Sensor, source.data.get("sensors")) if sensor.card in cards]
    driven = sorted(actuator for valve in valves for actuator in valve.actuators)
    if sorted(sensor.actuator for sensor in sensors) != driven:
        sensors = []
    bench = VentedBench(
        name=data["name"], cards=cards, valves=tuple(valves), sensors=tuple(sensors), triggers=tuple(triggers)
    )
    return bench, tuple(problems)


def _valid_items(kind: Any, values: Any) -> Iterable[tuple[Any, Any]]:
    """The valid items of a list or mapping, each with its index or key."""
    adapter: TypeAdapter[Any] = TypeAdapter(kind)
    for key, value in enumerate(values) if isinstance(values, list) else _mapping(values):
        try:
            yield key, adapter.validate_python(value)
        except ValidationError:
            continue


def _mapping(values: Any) -> Iterable[tuple[Any, Any]]:
    return values.items() if isinstance(values, Mapping) else ()
