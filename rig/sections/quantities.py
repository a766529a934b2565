"""Types of the values of a section; YAML speaks bar, mm, degrees and volts."""

from __future__ import annotations

import re
from datetime import datetime
from typing import Annotated, TypeVar

from pydantic import AfterValidator, Field, JsonValue

from protocols.validation import ValidationFault, faults


def _rising(span: tuple[float, float]) -> tuple[float, float]:
    if span[0] >= span[1]:
        raise ValueError("two numbers, the lower one first")
    return span


def _moment(text: str) -> str:
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        moment = None
    if moment is None or moment.tzinfo is None:
        raise ValueError("a date with time and zone in ISO 8601, such as '2026-11-21T14:05:00+01:00'")
    return text


_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,39}")
"""Names of rigs, cards and cameras; they become parts of file names, HDF5 paths and topics."""

_NAMED = "a name of up to 40 letters (a-z, A-Z), digits, '-' and '_', a letter or digit first"


_IN_SCHEMA: dict[str, JsonValue] = {"pattern": f"^{_NAME.pattern}$"}

Item = TypeVar("Item")


def _name(text: str) -> str:
    if not _NAME.fullmatch(text):
        raise ValueError(_NAMED)
    return text


def _names(items: dict[str, Item]) -> dict[str, Item]:
    faults(ValidationFault((key, "its name"), _NAMED) for key in items if not _NAME.fullmatch(key))
    return items


Positive = Annotated[float, Field(gt=0, allow_inf_nan=False, strict=True)]

NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False, strict=True)]

Number = Annotated[float, Field(allow_inf_nan=False, strict=True)]

Volt = Annotated[float, Field(ge=-10, le=10, allow_inf_nan=False, strict=True)]

Bar = Annotated[float, Field(gt=0, le=100, allow_inf_nan=False, strict=True)]

LengthMm = Annotated[float, Field(ge=0.01, le=10_000, allow_inf_nan=False, strict=True)]

MassG = Annotated[float, Field(ge=0, le=5_000, allow_inf_nan=False, strict=True)]

ModulusPa = Annotated[float, Field(ge=1e3, le=1e10, allow_inf_nan=False, strict=True)]
"""The lower bound rejects a modulus in kPa or MPa."""

Flag = Annotated[bool, Field(strict=True)]

Word = Annotated[str, Field(min_length=1, pattern=r"^[^\x00-\x1f\x7f]*$")]

Name = Annotated[str, Field(min_length=1, json_schema_extra=_IN_SCHEMA), AfterValidator(_name)]

Named = Annotated[
    dict[str, Item], Field(min_length=1, json_schema_extra={"propertyNames": _IN_SCHEMA}), AfterValidator(_names)
]

NamedOrNone = Annotated[dict[str, Item], Field(json_schema_extra={"propertyNames": _IN_SCHEMA}), AfterValidator(_names)]

Moment = Annotated[str, AfterValidator(_moment)]

Index = Annotated[int, Field(ge=0, strict=True)]

Count = Annotated[int, Field(ge=1, strict=True)]

ActuatorNumber = Annotated[int, Field(ge=1, strict=True)]

Triple = tuple[Number, Number, Number]

TranslationMm = Annotated[float, Field(ge=-100_000, le=100_000, allow_inf_nan=False, strict=True)]

RotationDeg = Annotated[float, Field(ge=-3_600, le=3_600, allow_inf_nan=False, strict=True)]

BarSpan = Annotated[
    tuple[
        Annotated[float, Field(ge=-1, le=100, allow_inf_nan=False, strict=True)],
        Annotated[float, Field(ge=-1, le=100, allow_inf_nan=False, strict=True)],
    ],
    AfterValidator(_rising),
]

VoltSpan = Annotated[tuple[Volt, Volt], AfterValidator(_rising)]
