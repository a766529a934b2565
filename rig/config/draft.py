"""A rig file on which overlays put values before it is validated: plain data with a source position of each value."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from protocols.document import Document
from protocols.source_positions import SourcePosition, YamlPath, shortened
from rig.config.board_sections import AnyBoard
from rig.config.card_sections import AnyCard, CardConfig
from rig.config.sections import AnyCamera, CameraConfig, Sensor
from rig.config.simulator_sections import Simulator
from rig.sections.plugins import RECORDED
from rig.valves.base import ValveSection
from rig.valves.registry import Valve


class Draft:
    """The plain data of a rig file, which overlays change. The file itself stays as it is.

    An overlay reads the parts that it compares or moves by the properties below, each valid by itself. A part that is
    missing or invalid is None or left out: the one validation at the end reports it.
    """

    def __init__(self, source: Document, *, recorded: bool = False) -> None:
        """`recorded`: the rig is from an archive, and its plug-ins need not be installed."""
        self._source = source
        self._context = {RECORDED: recorded}
        self._data: dict[str, Any] = deepcopy(source.data)
        self._positions = deepcopy(source.positions)

    @property
    def name(self) -> str:
        """The rig's name, for messages."""
        return str(self._data.get("name", Path(self._source.file).stem))

    @property
    def file(self) -> str:
        """The name of the rig file, without its folder."""
        return Path(self._source.file).name

    @property
    def cameras(self) -> dict[str, CameraConfig]:
        """The valid cameras by name."""
        return self._named("cameras", AnyCamera)

    @property
    def cards(self) -> dict[str, CardConfig]:
        """The valid cards by name."""
        return self._named("cards", AnyCard)

    @property
    def valves(self) -> list[ValveSection | None]:
        """The valves in their order."""
        return [self.part(Valve, "valves", index) for index in range(len(self.listed("valves")))]

    @property
    def sensors(self) -> list[Sensor | None]:
        """The pressure sensors in their order."""
        return [self.part(Sensor, "sensors", index) for index in range(len(self.listed("sensors")))]

    @property
    def board(self) -> Any:
        """The board on the end cap; None without one."""
        return self.part(AnyBoard, "board")

    @property
    def simulator(self) -> Simulator | None:
        """The simulated bench; None for a rig without one."""
        found: Simulator | None = self.part(Simulator, "simulator")
        return found

    def part(self, kind: Any, *path: str | int, default: Any = None) -> Any:
        """The value at a path as a section of type `kind`; `default` where there is none, None where it is invalid."""
        value = self.get(*path)
        if value is None:
            return default
        try:
            return _adapter_of(kind).validate_python(value, context=self._context)
        except ValidationError:
            return None

    def get(self, *path: str | int) -> Any:
        """The plain value at a path; None where there is none."""
        value: Any = self._data
        for step in path:
            try:
                value = value[step]
            except (LookupError, TypeError):
                return None
        return value

    def listed(self, key: str) -> list[Any]:
        """The list at a key of the file; empty where there is none."""
        value = self.get(key)
        return value if isinstance(value, list) else []

    def put(self, path: YamlPath, value: Any, origin: Document, at: YamlPath) -> None:
        """Put a value that comes from the place `at` of another file; keys on the way are made.

        A mapping changes only the keys that it has.
        """
        if isinstance(value, Mapping):
            for key, inner in value.items():
                self.put((*path, key), inner, origin, (*at, key))
            return
        there = origin.position(at)
        position = SourcePosition(there.line, there.column, shortened(str(value)), file=origin.file)
        self._set(path, value, position)

    def keep_what_is_simulated(self) -> None:
        """Keep what the rig states as the truth of its simulator: an overlay corrects what is stated, not the plant."""
        if not isinstance(self.get("simulator"), dict):
            return
        built = ("simulator", "built")
        if self.get(*built) is None:
            self._set((*built, "lenses"), {}, replace(self._position("simulator"), children={}))
        for name in self.cameras:
            self._copy(("cameras", name, "lens"), (*built, "lenses", name))
        self._copy(("valves",), (*built, "valves"))
        self._copy(("sensors",), (*built, "sensors"))
        self._copy(("board", "placement"), ("simulator", "board"))
        self._copy(("arm", "geometry"), ("simulator", "geometry"))
        for k in range(len(self.get("arm", "segments") or ())):
            self._copy(("arm", "segments", k, "geometry"), ("simulator", "segments", k, "geometry"))

    def drop(self, key: str) -> None:
        """Leave out a key of the file."""
        self._data.pop(key, None)

    def document(self) -> Document:
        """The file with what was put on it, to be validated."""
        return replace(self._source, data=self._data, positions=self._positions)

    def _named(self, key: str, kind: Any) -> dict[str, Any]:
        items = self.get(key)
        found = {name: self.part(kind, key, name) for name in items} if isinstance(items, dict) else {}
        return {name: part for name, part in found.items() if part is not None}

    def _position(self, *path: str | int) -> SourcePosition:
        return replace(self._source, positions=self._positions).position(path)

    def _copy(self, start: YamlPath, to: YamlPath) -> None:
        """Copy a value with its positions to a place where there is none."""
        if self.get(*start) is not None and self.get(*to) is None:
            self._set(to, deepcopy(self.get(*start)), deepcopy(self._position(*start)))

    def _set(self, path: YamlPath, value: Any, position: SourcePosition) -> None:
        data: Any = self._data
        positions = self._positions
        for step in path[:-1]:
            if isinstance(data, dict) and step not in data:
                data[step] = {}
                positions.children[step] = replace(position, children={})
            try:
                data, positions = data[step], positions.children[step]
            except (LookupError, TypeError):
                return  # the file has something else here, which the validation reports
        last: Any = path[-1]
        if isinstance(data, dict) or (isinstance(data, list) and last in range(len(data))):
            data[last] = value
            positions.children[last] = position


_ADAPTERS: dict[int, TypeAdapter[Any]] = {}


def _adapter_of(kind: Any) -> TypeAdapter[Any]:
    """The validator of a type, found by identity: the types are constants, and unions of plug-ins have no hash."""
    if id(kind) not in _ADAPTERS:
        _ADAPTERS[id(kind)] = TypeAdapter(kind)
    return _ADAPTERS[id(kind)]
