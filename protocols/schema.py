"""The protocol YAML: steps, repeats and sequences. A field of `Step` registers a kind of step."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, Any, NamedTuple

from pydantic import ConfigDict, Discriminator, Field, Tag, model_validator
from pydantic.json_schema import SkipJsonSchema

from protocols.parameters import PATTERN, ProtocolParameter
from protocols.steps.base import MOST_SEGMENTS, LeafStep, StepPart, Text
from protocols.steps.csv_file import Csv
from protocols.steps.pressure import Hold, Ramp, Sine, Staircase, Stream
from protocols.steps.prompt import PromptStep
from protocols.steps.tip import TipStep
from protocols.validation import ValidationFault, faults


def _text_or_weight(value: Any) -> str:
    return "with weight" if isinstance(value, dict | PromptStep) else "text"


class Repeat(StepPart):
    """Steps played several times over."""

    times: Annotated[int, Field(ge=1, le=MOST_SEGMENTS, strict=True)]
    steps: Annotated[tuple[Step, ...], Field(min_length=1)]


class InnerSteps(NamedTuple):
    """The steps that a step is made of, below `path` of its own YAML, and how often they are played.

    count_path: the path of the value that decides how often.
    """

    steps: tuple[Step, ...]
    path: tuple[str, ...] = ()
    times: int = 1
    count_path: tuple[str, ...] = ()


class Step(StepPart):
    """One step: exactly one of these."""

    model_config = ConfigDict(json_schema_extra={"minProperties": 1, "maxProperties": 1})

    ramp: Ramp | SkipJsonSchema[None] = None
    staircase: Staircase | SkipJsonSchema[None] = None
    sine: Sine | SkipJsonSchema[None] = None
    hold: Hold | SkipJsonSchema[None] = None
    csv: Csv | SkipJsonSchema[None] = None
    tip: TipStep | SkipJsonSchema[None] = None
    stream: Stream | SkipJsonSchema[None] = None
    prompt: (
        Annotated[
            Annotated[Text, Tag("text")] | Annotated[PromptStep, Tag("with weight")], Discriminator(_text_or_weight)
        ]
        | SkipJsonSchema[None]
    ) = Field(default=None, description="the run waits until the operator confirms")
    sequence: Annotated[tuple[Step, ...], Field(min_length=1)] | SkipJsonSchema[None] = Field(
        default=None, description="steps one after the other, so that an alias can name them all"
    )
    repeat: Repeat | SkipJsonSchema[None] = None

    @model_validator(mode="before")
    @classmethod
    def _single(cls, value: Any) -> Any:
        """Require a mapping with one key that has a value, before more specific checks."""
        if not isinstance(value, dict):
            return value
        kinds = tuple(cls.model_fields)
        empty = [key for key in value if value[key] is None and key in kinds]
        rest = ", ".join(key for key in value if key not in kinds)
        if not value:
            faults([ValidationFault((), f"needs one of {', '.join(kinds)}")])
        if empty and rest:
            faults([ValidationFault((), f"indent the lines that belong to '{empty[0]}:' further than it ({rest})")])
        named = next((str(value[key]) for key in ("kind", "type", "step") if key in value), "")
        if named in kinds and not set(kinds) & set(value):
            faults([ValidationFault((), f"write the step's name as the key of all the rest: '- {named}: {{...}}'")])
        if sum(key in kinds for key in value) > 1:
            faults([ValidationFault((), f"write {' and '.join(value)} as separate steps, each with its own '- '")])
        return value

    @property
    def kind(self) -> str:
        """The one key that is there."""
        return next(iter(self.model_fields_set))

    @property
    def body(self) -> LeafStep | InnerSteps:
        """What is under that key."""
        body: LeafStep | Repeat | tuple[Step, ...] | str = getattr(self, self.kind)
        if isinstance(body, str):
            return PromptStep(message=body)
        if isinstance(body, Repeat):
            return InnerSteps(body.steps, ("steps",), body.times, ("times",))
        return body if isinstance(body, LeafStep) else InnerSteps(body)


def leaves(
    steps: Sequence[Step], base: tuple[str | int, ...] = ("steps",), *, unrolled: bool = False
) -> Iterator[tuple[tuple[str | int, ...], LeafStep]]:
    """Path and content of every step that is not made of steps; `unrolled`: as often as it is played."""
    for index, step in enumerate(steps):
        body, here = step.body, (*base, index, step.kind)
        if isinstance(body, InnerSteps):
            for _ in range(body.times if unrolled else 1):
                yield from leaves(body.steps, (*here, *body.path), unrolled=unrolled)
        else:
            yield here, body


class ProtocolFile(StepPart):
    """A protocol: what the experimenter asks for, step after step, from 0 bar on every actuator."""

    title: Text
    description: str = ""
    parameters: dict[str, ProtocolParameter] = Field(default={}, description="numbers that the steps use by name")
    steps: Annotated[tuple[Step, ...], Field(min_length=1)]


def editor_schema() -> dict[str, Any]:
    """The JSON Schema of protocols as written: a number of a step may be an expression of the parameters."""
    schema = ProtocolFile.model_json_schema()
    parts = {
        name: part if name == ProtocolParameter.__name__ else _with_expressions(part)
        for name, part in schema["$defs"].items()
    }
    expression = {
        "description": "parameters, times or over numbers, and their sums: peak_bar / 2",
        "pattern": PATTERN,
        "type": "string",
    }
    return {**schema, "$defs": {"Expression": expression, **parts}}


def _with_expressions(schema: Any) -> Any:
    if isinstance(schema, list):
        return [_with_expressions(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    if schema.get("type") in {"number", "integer"}:
        words = {key: value for key, value in schema.items() if key in {"default", "description", "title"}}
        number = {key: value for key, value in schema.items() if key not in words}
        return {**words, "anyOf": [number, {"$ref": "#/$defs/Expression"}]}
    return {key: _with_expressions(value) for key, value in schema.items()}
