"""The expected value at a position of a YAML file, in words, from the JSON schema of its pydantic model."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

_UNITS = (
    ("_bar_per_s", "bar/s"),
    ("_mm_per_s", "mm/s"),
    ("_rad_s", "rad/s"),
    ("_l_min", "l/min"),
    ("_per_bar", "1/bar"),
    ("_per_N2", "1/N²"),
    ("_per_N", "1/N"),
    ("_kg_m3", "kg/m³"),
    ("_percent", "%"),
    ("_bar", "bar"),
    ("_deg", "degrees"),
    ("_rad", "rad"),
    ("_hz", "Hz"),
    ("_mm", "mm"),
    ("_ms", "ms"),
    ("_ml", "ml"),
    ("_px", "px"),
    ("_pa", "Pa"),
    ("_g", "g"),
    ("_k", "K"),
    ("_s", "s"),
    ("_V", "V"),
)

UNITS = tuple(unit for _, unit in _UNITS)

_IN_UNIT = {
    "bar": {"Pa": 1e-5, "hPa": 1e-3, "mbar": 1e-3, "kPa": 1e-2, "MPa": 10.0, "psi": 0.0689475729},
    "mm": {"um": 1e-3, "µm": 1e-3, "cm": 10.0, "m": 1e3},
    "s": {"ms": 1e-3, "min": 60.0, "h": 3600.0},
    "ms": {"us": 1e-3, "s": 1e3},
    "g": {"kg": 1e3},
    "degrees": {"deg": 1.0, "°": 1.0, "rad": 57.2957795131},
    "Hz": {"kHz": 1e3},
    "V": {"mV": 1e-3},
    "Pa": {"kPa": 1e3, "MPa": 1e6, "GPa": 1e9, "bar": 1e5},
    "ml": {"l": 1e3},
}
"""Factor of each unit that people write, by the unit that a key has."""


def factor_to(unit: str, written: str) -> float | None:
    """What a number in the written unit is multiplied by to be in `unit`; None for a unit that cannot be converted."""
    return 1.0 if written == unit else _IN_UNIT.get(unit, {}).get(written)


Schema = dict[str, Any]


def unit_of(key: str) -> str:
    """The unit that a key's name ends in, or an empty string."""
    return next((unit for ending, unit in _UNITS if key.endswith(ending)), "")


def wants_number(schema: Schema) -> bool:
    """True if a number, or one of several kinds of value that are numbers, fits the schema."""
    branches = (schema, *(schema.get("anyOf") or schema.get("oneOf") or ()))
    return any(branch.get("type") in {"number", "integer"} for branch in branches)


class Expectation:
    """The schema of one model, walked along the path of a value."""

    def __init__(self, schema: Schema, nested: Mapping[tuple[str | int, ...], Schema] | None = None) -> None:
        """`nested` are the schemas of models that were chosen during validation, by the path of their values."""
        self._root = schema
        self._nested = {path: Expectation(inner) for path, inner in (nested or {}).items()}

    def at(self, path: tuple[str | int, ...], data: Any) -> Schema:
        """The schema of the value at `path` in `data`; empty where the path leaves what the schema knows."""
        if inside := self._inside_nested(path, data):
            model, rest, value = inside
            return model.at(rest, value)
        schema = self._resolved(self._root)
        for step in path:
            schema = self._chosen(schema, data)
            if isinstance(step, int):
                fixed = schema.get("prefixItems", [])
                inner = fixed[step] if step < len(fixed) else schema.get("items", {})
            else:
                inner = schema.get("properties", {}).get(step)
                if inner is None:
                    extra = schema.get("additionalProperties")
                    inner = extra if isinstance(extra, dict) else {}
            schema = self._resolved(inner)
            data = _inside(data, step)
        return self._chosen(schema, data)

    def keys(self, path: tuple[str | int, ...], data: Any) -> tuple[str, ...]:
        """The keys known at `path`."""
        return tuple(self.at(path, data).get("properties", {}))

    def words(self, path: tuple[str | int, ...], data: Any) -> str:
        """The expectation at `path` as a phrase: 'a number above 0 (bar)'."""
        if inside := self._inside_nested(path, data):
            model, rest, value = inside
            return model.words(rest, value)
        name = next((step for step in reversed(path) if isinstance(step, str)), "")
        return self._phrase(self.at(path, data), unit_of(name))

    def _inside_nested(
        self, path: tuple[str | int, ...], data: Any
    ) -> tuple[Expectation, tuple[str | int, ...], Any] | None:
        """The nested model that the path leads into, the rest of the path, and the model's value."""
        for depth, step in enumerate(path, 1):
            data = _inside(data, step)
            if model := self._nested.get(path[:depth]):
                return model, path[depth:], data
        return None

    def _phrase(self, schema: Schema, unit: str = "") -> str:
        schema = self._resolved(schema)
        branches = schema.get("oneOf") or schema.get("anyOf")
        if branches and "discriminator" not in schema:
            return ", or ".join(self._phrase(branch, unit) for branch in branches)
        if "const" in schema:
            return json.dumps(schema["const"])
        if "enum" in schema:
            return "one of " + ", ".join(str(word) for word in schema["enum"])
        kind = schema.get("type")
        if kind in {"number", "integer"}:
            noun = "a number" if kind == "number" else "a whole number"
            return noun + _bounds(schema) + (f" ({unit})" if unit else "")
        if kind == "string":
            return "text (one line, not empty)" if schema.get("minLength") else "text"
        if kind == "boolean":
            return "true or false"
        if kind == "array":
            return self._list_phrase(schema, unit)
        if "properties" in schema:
            return f"a mapping ('key: value' lines) with some of {', '.join(schema['properties'])}"
        return "a mapping ('key: value' lines)" + (" with at least one key" if schema.get("minProperties") else "")

    def _list_phrase(self, schema: Schema, unit: str) -> str:
        fixed = schema.get("prefixItems")
        item = self._resolved(fixed[0] if fixed else schema.get("items", {}))
        inner = self._phrase(item, unit)
        least = schema.get("minItems", 0)
        if fixed and ("anyOf" in item or "oneOf" in item):
            return f"a list of {len(fixed)} items"
        if "properties" in item or "oneOf" in item:
            some = "one item" if least == 1 else f"{least} items"
            return f"a list ('- ' items) with at least {some}" if least else "a list ('- ' items)"
        plural = inner.replace("a whole number", "whole numbers", 1).replace("a number", "numbers", 1)
        if fixed:
            return f"a list of {len(fixed)} {plural}"
        return f"a list of {plural}" + (f", at least {least}" if least else "")

    def _resolved(self, schema: Schema) -> Schema:
        while "$ref" in schema:
            name = schema["$ref"].rsplit("/", 1)[-1]
            schema = {**self._root["$defs"][name], **{k: v for k, v in schema.items() if k != "$ref"}}
        return schema

    def _chosen(self, schema: Schema, data: Any) -> Schema:
        """The alternative that fits `data`: by its tag, or by list, mapping or plain value."""
        branches = [self._resolved(branch) for branch in schema.get("oneOf") or schema.get("anyOf") or ()]
        if not branches:
            return schema
        tag = schema.get("discriminator", {}).get("propertyName")
        if tag is not None:
            word = data.get(tag) if isinstance(data, dict) else None
            for branch in branches:
                stated = branch.get("properties", {}).get(tag, {})
                if stated.get("const") == word or (word is None and "default" in stated):
                    return branch
            return {"type": "object", "properties": {tag: {"enum": list(schema["discriminator"]["mapping"])}}}
        kind = "array" if isinstance(data, list) else "object" if isinstance(data, dict) else ""
        return next((branch for branch in branches if branch.get("type") == kind), schema)


def in_bounds(schema: Schema, number: float) -> bool:
    """Whether a number is within the bounds of a schema."""
    lowest, highest = schema.get("minimum", -math.inf), schema.get("maximum", math.inf)
    above, below = schema.get("exclusiveMinimum", -math.inf), schema.get("exclusiveMaximum", math.inf)
    return bool(lowest <= number <= highest and above < number < below)


def _inside(data: Any, step: str | int) -> Any:
    if isinstance(data, dict):
        return data.get(str(step))
    if isinstance(data, list) and isinstance(step, int) and step < len(data):
        return data[step]
    return None


def _bounds(schema: Schema) -> str:
    words = [
        f"{word} {schema[key]:.12g}{after}"
        for key, word, after in (
            ("exclusiveMinimum", "above", ""),
            ("minimum", "of", " or more"),
            ("exclusiveMaximum", "below", ""),
            ("maximum", "up to", ""),
        )
        if key in schema
    ]
    if "minimum" in schema and "maximum" in schema:
        return f" from {schema['minimum']:.12g} to {schema['maximum']:.12g}"
    return " " + " and ".join(words) if words else ""
