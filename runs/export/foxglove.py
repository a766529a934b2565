"""An archive as an MCAP file that Foxglove and PlotJuggler plot, play and draw: JSON with Foxglove's own schemas.

The schemas' fields are those of https://docs.foxglove.dev/docs/sdk/schemas; lengths in space are in metres there.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from heapq import merge
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from runs.records import Level
from runs.run import Run
from runs.table import Column, facts, table, tables

SUFFIX = ".foxglove.mcap"
"""Distinguishes the file from a journal, which is also MCAP."""
FRAME_ID = "rod_base"
_DRAWN = ("frames", "events")
"""Tables with topics of their own."""
_LOG_LEVEL = {Level.INFO: 2, Level.WARNING: 3, Level.FAULT: 4}
_POINTS, _LINE_STRIP = 1, 3
_YELLOW, _BLUE, _ORANGE = (0.94, 0.89, 0.26), (0.0, 0.45, 0.70), (0.84, 0.37, 0.0)
_LINE_M, _TIP_M = 0.003, 0.006

Message = tuple[int, str, dict[str, Any]]
"""Time [ns since 1970], topic, content."""


def write(run: Run, path: Path) -> None:
    """Write the MCAP file, its messages in the order of time."""
    numbers = {group: _numbers(run, group) for group in tables(run.path) if group not in _DRAWN}
    schemas = {f"/{group}": _schema_of_rows(group, columns) for group, columns in numbers.items()}
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="", library="softrig")
        channels: dict[str, int] = {}
        counts: dict[str, int] = {}
        for t_ns, topic, content in merge(*_streams(run, numbers), key=itemgetter(0)):
            if topic not in channels:
                name, schema = schemas.get(topic) or _schema(topic, content)
                number = writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
                channels[topic] = writer.register_channel(topic, "json", number)
            counts[topic] = counts.get(topic, 0) + 1
            data = json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
            writer.add_message(channels[topic], t_ns, data, t_ns, counts[topic])
        header = run.header
        about = {"run_id": header.run_id, "title": header.title, "simulated": str(header.simulated).lower()}
        writer.add_metadata("run", about | header.inputs)
        writer.add_metadata("facts", dict(_facts(run)))
        writer.finish()  # type: ignore[no-untyped-call]


def _streams(run: Run, numbers: Mapping[str, Mapping[str, Column]]) -> Iterator[Iterable[Message]]:
    start_ns = run.header.started_utc_ns
    for group, columns in numbers.items():
        yield _rows(group, columns, start_ns)
    yield _arm(run, start_ns)
    yield _pictures(run, start_ns)
    # Events are recorded in the order of arrival, not of their times.
    yield iter(sorted(_events(run), key=itemgetter(0)))


def _numbers(run: Run, group: str) -> dict[str, Column]:
    """Return the numbers of a table in the order of its times, in bar and mm."""
    columns = {name: column for name, column in table(run.path, group).items() if column.dtype.kind in "fiu"}
    order = np.argsort(columns["time_s"], kind="stable")
    return {name: column[order] for name, column in columns.items()}


def _schema_of_rows(group: str, columns: Mapping[str, Column]) -> tuple[str, dict[str, Any]]:
    """Return the schema of a table: of all its columns, also of those that its first row lacks."""
    kinds = {name: "number" if column.dtype.kind == "f" else "integer" for name, column in columns.items()}
    properties = {name: {"type": kind} for name, kind in kinds.items() if name != "time_s"}
    return f"softrig.{group}", {"type": "object", "properties": properties}


def _rows(group: str, columns: Mapping[str, Column], start_ns: int) -> Iterator[Message]:
    """Rows of a table as flat objects; what was not measured is left out."""
    names = [name for name in columns if name != "time_s"]
    values = (columns[name].tolist() for name in names)
    for t, *row in zip(_absolute(columns["time_s"], start_ns).tolist(), *values, strict=True):
        known = {name: v for name, v in zip(names, row, strict=True) if isinstance(v, int) or math.isfinite(v)}
        yield t, f"/{group}", known


def _facts(run: Run) -> Iterator[tuple[str, str]]:
    """Yield each field that is in no table: its path, with its label where there are several, and its value."""
    columns = facts(run.path)
    for field, label, value, unit in zip(*(columns[n] for n in ("field", "of", "value", "unit")), strict=True):
        yield f"{field} {label}".strip(), f"{value} {unit}".strip()


def _arm(run: Run, start_ns: int) -> Iterator[Message]:
    """The model's backbone and both tips in space."""
    tip = run.tip
    if run.backbone is None:
        return
    lines = run.backbone.model_mm.astype(float) / 1e3
    for row, t in enumerate(_absolute(tip.time_s, start_ns).tolist()):
        spheres = [
            _sphere(point / 1e3, colour)
            for point, colour in ((tip.measured_mm[row], _BLUE), (tip.model_mm[row], _ORANGE))
            if np.isfinite(point).all()
        ]
        line = [_line(lines[row])] if np.isfinite(lines[row]).all() else []
        yield (
            t,
            "/arm",
            {"deletions": [], "entities": [_entity(t, lines=line, spheres=spheres)]},
        )


def _pictures(run: Run, start_ns: int) -> Iterator[Message]:
    """The stored pictures with their annotations."""
    frames = run.frames
    times = _absolute(frames.time_s, start_ns)
    for k in np.argsort(times, kind="stable").tolist():
        t, camera = int(times[k]), frames.camera[k]
        data = base64.b64encode(run.picture(k)).decode()
        about = {"timestamp": _stamp(t), "frame_id": camera, "format": frames.encoding[k], "data": data}
        yield t, f"/{camera}/image", about
        annotations = [
            _points(t, frames.corners_px[k], _POINTS, _YELLOW, 3.0),
            _points(t, frames.backbone_px[k], _LINE_STRIP, _ORANGE, 2.0),
        ]
        circles = [
            _circle(t, frames.tip_px[k], 16.0, _BLUE),
            _circle(t, frames.model_px[k], 8.0, _ORANGE),
        ]
        content = {"circles": [c for c in circles if c], "points": [p for p in annotations if p], "texts": []}
        yield t, f"/{camera}/marks", content


def _events(run: Run) -> Iterator[Message]:
    offset_ns = run.header.started_utc_ns - run.header.started_t_ns
    for event in run.events:
        t = event.t_ns + offset_ns
        level = _LOG_LEVEL[event.level]
        about = {"timestamp": _stamp(t), "level": level, "message": event.message, "name": event.source}
        yield t, "/events", about | {"file": "", "line": 0}


def _absolute(time_s: NDArray[np.float64], start_ns: int) -> NDArray[np.int64]:
    return start_ns + np.round(time_s * 1e9).astype(np.int64)


def _stamp(t_ns: int) -> dict[str, int]:
    return {"sec": t_ns // 1_000_000_000, "nsec": t_ns % 1_000_000_000}


def _colour(rgb: tuple[float, float, float], opacity: float = 1.0) -> dict[str, float]:
    return {"r": rgb[0], "g": rgb[1], "b": rgb[2], "a": opacity}


def _xyz(point: Iterable[float]) -> dict[str, float]:
    return dict(zip("xyz", (round(float(v), 9) for v in point), strict=True))


def _pose(point: Iterable[float]) -> dict[str, Any]:
    return {"position": _xyz(point), "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}


def _entity(t_ns: int, **primitives: list[dict[str, Any]]) -> dict[str, Any]:
    kinds = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
    about: dict[str, Any] = {"timestamp": _stamp(t_ns), "frame_id": FRAME_ID, "id": "arm", "frame_locked": False}
    lifetime = {"lifetime": {"sec": 0, "nsec": 0}, "metadata": []}
    return about | lifetime | {kind: primitives.get(kind, []) for kind in kinds}


def _line(points_m: NDArray[np.float64]) -> dict[str, Any]:
    about = {"type": 0, "pose": _pose((0, 0, 0)), "thickness": _LINE_M, "scale_invariant": False}
    return about | {"points": [_xyz(p) for p in points_m], "color": _colour(_ORANGE), "colors": [], "indices": []}


def _sphere(point_m: NDArray[np.float64], rgb: tuple[float, float, float]) -> dict[str, Any]:
    return {"pose": _pose(point_m), "size": _xyz((_TIP_M,) * 3), "color": _colour(rgb, 0.8)}


def _pixels(points: NDArray[np.float32]) -> list[dict[str, float]]:
    known = points[np.isfinite(points).all(axis=1)]
    return [{"x": round(float(u), 2), "y": round(float(v), 2)} for u, v in known]


def _points(
    t_ns: int, points: NDArray[np.float32], kind: int, rgb: tuple[float, float, float], thickness: float
) -> dict[str, Any] | None:
    shown = _pixels(points)
    about = {"timestamp": _stamp(t_ns), "type": kind, "points": shown, "outline_color": _colour(rgb)}
    return about | {"outline_colors": [], "fill_color": _colour(rgb), "thickness": thickness} if shown else None


def _circle(
    t_ns: int, point: NDArray[np.float32], diameter: float, rgb: tuple[float, float, float]
) -> dict[str, Any] | None:
    if not np.isfinite(point).all():
        return None
    about = {"timestamp": _stamp(t_ns), "position": _pixels(point[None])[0], "diameter": diameter, "thickness": 2.0}
    return about | {"fill_color": _colour(rgb, 0.0), "outline_color": _colour(rgb)}


def _schema(topic: str, content: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """Return the name of a topic's schema and the schema; Foxglove knows its own by their names."""
    last = topic.rpartition("/")[2]
    known = {"image": "CompressedImage", "marks": "ImageAnnotations", "arm": "SceneUpdate", "events": "Log"}
    properties: dict[str, Any] = {name: _kind(value) for name, value in content.items()}
    if last == "image":
        properties["data"] = {"type": "string", "contentEncoding": "base64"}
    name = f"foxglove.{known[last]}" if last in known else f"softrig.{last}"
    return name, {"type": "object", "properties": properties}


def _kind(value: Any) -> dict[str, Any]:
    if isinstance(value, dict):
        return {"type": "object", "properties": {name: _kind(item) for name, item in value.items()}}
    if isinstance(value, list):
        return {"type": "array", "items": {"type": "object"}}
    return {"type": "string" if isinstance(value, str) else "integer" if isinstance(value, int) else "number"}
