"""What the rig file says about specimen and user, and which of it every run must state."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated

from pydantic import Field, model_validator

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
        """The values as text."""
        return {name: v if isinstance(v, str) else f"{v:.12g}" for name, v in self.values.items()}


def name_expected(name: str) -> str:
    """What is expected instead of the name of a metadata field; empty if it can be one."""
    if name in TAKEN:
        return TAKEN[name]
    return "" if NAME.fullmatch(name) else "a name of letters, digits and _ that begins with a letter"


def run_metadata(metadata: Metadata, given: Mapping[str, str], rig: Document) -> tuple[dict[str, str], list[Problem]]:
    """The metadata of a run, where `given` overrides the values of the file `rig`; and every problem of both."""
    problems = [
        Problem("--meta", 0, 0, "", f"{name}={value}", expected)
        for name, value in given.items()
        if (expected := name_expected(name))
    ]
    found = {**metadata.texts(), **given}
    for index, name in enumerate(metadata.required):
        if name not in found:
            expected = f"a value of {name} for this run: --meta {name}=VALUE, or metadata, values, {name} in this file"
            problems.append(rig.problem(("metadata", "required", index), expected, name))
    return found, problems
