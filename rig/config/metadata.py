"""What the rig file says about specimen and user, and which of it every run must state."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from typing import Annotated

from pydantic import Field, model_validator

from protocols.arguments import TEXT, finite, shown, storable
from protocols.problems import Problem
from protocols.source_positions import Document
from protocols.validation import ValidationFault, faults
from rig.sections.base import Section

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
TAKEN = {"name": "specimen, or the option --operator", "operator": "the option --operator"}
"""Names that the archive uses itself, and what states them."""

Value = Annotated[str, Field(min_length=1)] | Annotated[float, Field(allow_inf_nan=False, strict=True)]


class Metadata(Section):
    """Facts about the specimen and the user, for the archive."""

    required: tuple[str, ...] = Field(default=(), description="names that `values` or `rig run --meta` must give")
    values: dict[str, Value] = Field(default={}, description="text or number by name: specimen, batch, ..")

    @model_validator(mode="after")
    def _check(self) -> Metadata:
        named: list[tuple[tuple[str | int, ...], str]] = [
            (("required", index), name) for index, name in enumerate(self.required)
        ]
        named += [(("values", name), name) for name in self.values]
        faults(ValidationFault(path, name_expected(name)) for path, name in named if name_expected(name))
        return self

    def texts(self) -> dict[str, str]:
        return {name: _text(value) for name, value in self.values.items()}

    def missing(self, stated: Collection[str]) -> tuple[str, ...]:
        """The required names that are not in `stated`, the metadata of a run."""
        return tuple(name for name in self.required if name not in stated)


def _text(value: str | float) -> str:
    return value if isinstance(value, str) else f"{float(value):.12g}"


def name_expected(name: object) -> str:
    """What is expected instead of the name of a metadata field; empty if it can be one."""
    if name in TAKEN:
        return TAKEN[str(name)]
    if isinstance(name, str) and NAME.fullmatch(name):
        return ""
    return "a name of letters, digits and _ that begins with a letter"


def run_metadata(metadata: Metadata, given: object, rig: Document) -> tuple[dict[str, str], list[Problem]]:
    """The metadata of a run, where the mapping `given` overrides the values of the file `rig`; and every problem."""
    if not isinstance(given, Mapping):
        return metadata.texts(), [Problem("--meta", 0, 0, "", shown(given), "a mapping from names to values")]
    problems = []
    found = metadata.texts()
    for name, value in given.items():
        expected = name_expected(name)
        if not expected and not (value and storable(value)) and finite(value) is None:
            expected = f"a finite number, or {TEXT}, not empty"
        if expected:
            problems.append(Problem("--meta", 0, 0, "", f"{shown(name)}={shown(value)}", expected))
        else:
            found[name] = _text(value)
    for name in metadata.missing(found):
        expected = f"a value of {name} for this run: --meta {name}=VALUE, or metadata, values, {name} in this file"
        problems.append(rig.problem(("metadata", "required", metadata.required.index(name)), expected, name))
    return found, problems
