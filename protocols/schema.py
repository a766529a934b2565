"""The protocol YAML: which steps there are and what each may say.

Levels are gauge pressures in bar, times in seconds. A number that may differ between actuators is either one number
for all of them or a list with one number for each, in the order of `actuators`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, model_validator
from pydantic.json_schema import SkipJsonSchema

from protocols.decimals import levels_bar, uneven_stairs
from protocols.validation import ValidationFault, faults

MOST_SEGMENTS = 20_000
LONGEST_S = 1e6
HIGHEST_BAR = 100.0


def _list_or_number(value: Any) -> str:
    return "each" if isinstance(value, list | tuple) else "all"


Bar = Annotated[float, Field(ge=0, le=HIGHEST_BAR, allow_inf_nan=False, strict=True)]
BarAbove = Annotated[float, Field(gt=0, le=HIGHEST_BAR, allow_inf_nan=False, strict=True)]
Grams = Annotated[float, Field(ge=0, le=1e5, allow_inf_nan=False, strict=True)]
Number = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False, strict=True)]
Positive = Annotated[float, Field(gt=0, le=LONGEST_S, allow_inf_nan=False, strict=True)]
Seconds = Annotated[float, Field(gt=0, le=LONGEST_S, allow_inf_nan=False, strict=True)]
SecondsOrNone = Annotated[float, Field(ge=0, le=LONGEST_S, allow_inf_nan=False, strict=True)]
Actuator = Annotated[int, Field(ge=1, le=64, strict=True)]
Actuators = Annotated[tuple[Actuator, ...], Field(min_length=1, description="numbers of the actuators it drives")]
Text = Annotated[str, Field(min_length=1)]

BarEach = Annotated[
    Annotated[Bar, Tag("all")] | Annotated[tuple[Bar, ...], Tag("each")], Discriminator(_list_or_number)
]
NumberEach = Annotated[
    Annotated[Number, Tag("all")] | Annotated[tuple[Number, ...], Tag("each")], Discriminator(_list_or_number)
]
PositiveEach = Annotated[
    Annotated[Positive, Tag("all")] | Annotated[tuple[Positive, ...], Tag("each")], Discriminator(_list_or_number)
]


def _text_or_weight(value: Any) -> str:
    return "with weight" if isinstance(value, dict | PromptStep) else "text"


class StepPart(BaseModel):
    """A mapping of the YAML: unknown keys are errors, nothing is coerced."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)


class MotionStep(StepPart):
    """What the steps that move or hold pressures have in common."""

    label: Text | SkipJsonSchema[None] = Field(default=None, description="its name in reports")


def each(value: float | tuple[float, ...], count: int) -> tuple[float, ...]:
    """One value per actuator, from one for all or one for each."""
    return value if isinstance(value, tuple) else (value,) * count


def _fits(actuators: Sequence[int], values: dict[str, float | tuple[float, ...] | None]) -> list[ValidationFault]:
    found = []
    twice = sorted({number for number in actuators if list(actuators).count(number) > 1})
    if twice:
        found.append(ValidationFault(("actuators",), f"each actuator once; {twice[0]} is named twice"))
    for name, value in values.items():
        if isinstance(value, tuple) and len(value) != len(actuators):
            found.append(
                ValidationFault(
                    (name,), f"one number, or one for each of the {len(actuators)} actuators, not {len(value)}"
                )
            )
    return found


def _one_of(names: Sequence[str], given: Sequence[object]) -> list[ValidationFault]:
    present = [name for name, value in zip(names, given, strict=True) if value is not None]
    if len(present) == 1:
        return []
    if not present:
        return [ValidationFault((), f"needs {' or '.join(names)}")]
    return [ValidationFault((present[-1],), f"{' or '.join(names)}, not both")]


class Ramp(MotionStep):
    """From where the set-points stand to `to_bar`, in `duration_s` or at `rate_bar_per_s`; linear, or smooth at both
    ends.
    """

    actuators: Actuators
    to_bar: BarEach = Field(description="level at the end")
    duration_s: Seconds | SkipJsonSchema[None] = None
    rate_bar_per_s: Positive | SkipJsonSchema[None] = Field(default=None, description="of the actuator that moves most")
    shape: Literal["linear", "smooth"] = "linear"

    @model_validator(mode="after")
    def _check(self) -> Ramp:
        faults(
            _fits(self.actuators, {"to_bar": self.to_bar})
            + _one_of(("duration_s", "rate_bar_per_s"), (self.duration_s, self.rate_bar_per_s))
        )
        return self


class Staircase(MotionStep):
    """Levels from `start_bar` to `stop_bar`, both included, `step_bar` apart, each held for `dwell_s`; upwards or
    downwards. A new level is jumped to, or approached linearly in `rise_s`.
    """

    actuators: Actuators
    start_bar: Bar
    stop_bar: Bar
    step_bar: BarAbove = Field(description="distance of the levels; start and stop give the direction")
    dwell_s: Seconds = Field(description="time at each level")
    rise_s: SecondsOrNone = Field(default=0.0, description="time of the change to a level; 0 jumps")

    @model_validator(mode="after")
    def _check(self) -> Staircase:
        found = _fits(self.actuators, {})
        uneven = uneven_stairs(self.start_bar, self.stop_bar, self.step_bar)
        if uneven:
            found.append(ValidationFault(("step_bar",), *uneven))
        faults(found)
        return self

    def levels_bar(self) -> tuple[float, ...]:
        """The levels, in order."""
        return levels_bar(self.start_bar, self.stop_bar, self.step_bar)


class Sine(MotionStep):
    """mean + amplitude sin(omega t + phase), t from the start of the sinusoid. With `lead_in_s` the set-points first
    fade smoothly from where they stand into the sinusoid; without, they jump to its first value.
    """

    actuators: Actuators
    mean_bar: BarEach
    amplitude_bar: BarEach
    omega_rad_s: PositiveEach | SkipJsonSchema[None] = Field(default=None, description="angular frequency")
    frequency_hz: PositiveEach | SkipJsonSchema[None] = Field(default=None, description="instead of omega_rad_s")
    phase_deg: NumberEach | SkipJsonSchema[None] = Field(default=None, description="at the start; 0 if left out")
    phase_rad: NumberEach | SkipJsonSchema[None] = Field(default=None, description="instead of phase_deg")
    duration_s: Seconds | SkipJsonSchema[None] = None
    periods: Positive | SkipJsonSchema[None] = Field(default=None, description="instead of duration_s")
    lead_in_s: SecondsOrNone = 0.0

    @model_validator(mode="after")
    def _check(self) -> Sine:
        names = ("mean_bar", "amplitude_bar", "omega_rad_s", "frequency_hz", "phase_deg", "phase_rad")
        found = _fits(self.actuators, {name: getattr(self, name) for name in names})
        found += _one_of(("omega_rad_s", "frequency_hz"), (self.omega_rad_s, self.frequency_hz))
        found += _one_of(("duration_s", "periods"), (self.duration_s, self.periods))
        if self.phase_deg is not None and self.phase_rad is not None:
            found.append(ValidationFault(("phase_rad",), "phase_deg or phase_rad, not both"))
        speeds = self.omega_rad_s if self.frequency_hz is None else self.frequency_hz
        if self.periods is not None and isinstance(speeds, tuple) and len(set(speeds)) > 1:
            found.append(ValidationFault(("periods",), "duration_s, because the frequencies differ"))
        count = len(self.actuators)
        if not found:
            for mean, amplitude in zip(each(self.mean_bar, count), each(self.amplitude_bar, count), strict=True):
                if amplitude > mean:
                    expected = f"an amplitude up to the mean ({mean:g} bar): the pressure would fall below 0"
                    found.append(ValidationFault(("amplitude_bar",), expected))
                    break
        faults(found)
        return self


class Hold(MotionStep):
    """Stay for `duration_s`: where the set-points stand, or, with `level_bar`, at a level jumped to at once."""

    duration_s: Seconds
    actuators: Actuators | SkipJsonSchema[None] = Field(default=None, description="only with level_bar")
    level_bar: BarEach | SkipJsonSchema[None] = Field(default=None, description="only with actuators")

    @model_validator(mode="after")
    def _check(self) -> Hold:
        if (self.actuators is None) != (self.level_bar is None):
            faults([ValidationFault((), "needs actuators and level_bar, or neither")])
        faults(_fits(self.actuators or (), {"level_bar": self.level_bar}))
        return self


class Csv(MotionStep):
    """Set-points from a CSV file beside the protocol: a column `time_s` and a column `actuator_N_bar` for each
    actuator. Time counts from the first row. With `lead_in_s` the first values are approached smoothly.
    """

    file: Text = Field(description="path, relative to the protocol's folder")
    actuators: Actuators
    between: Literal["linear", "hold"] = Field(default="linear", description="what happens between the rows")
    lead_in_s: SecondsOrNone = 0.0

    @model_validator(mode="after")
    def _check(self) -> Csv:
        faults(_fits(self.actuators, {}))
        return self


class PromptStep(StepPart):
    """What the operator has to do; the run waits until it is confirmed. With `weight_g` the model, and a simulated
    arm, carry that weight on the end cap from then on; without, what hangs there stays.
    """

    message: Text
    weight_g: Grams | SkipJsonSchema[None] = Field(default=None, description="hung on the end cap from now on")


class Repeat(StepPart):
    """Steps played several times over."""

    times: Annotated[int, Field(ge=1, le=MOST_SEGMENTS, strict=True)]
    steps: Annotated[tuple[Step, ...], Field(min_length=1)]


class Step(StepPart):
    """One step: exactly one of these."""

    model_config = ConfigDict(json_schema_extra={"minProperties": 1, "maxProperties": 1})

    ramp: Ramp | SkipJsonSchema[None] = None
    staircase: Staircase | SkipJsonSchema[None] = None
    sine: Sine | SkipJsonSchema[None] = None
    hold: Hold | SkipJsonSchema[None] = None
    csv: Csv | SkipJsonSchema[None] = None
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


class ProtocolFile(StepPart):
    """A protocol: what the experimenter asks for, step after step, from 0 bar on every actuator."""

    title: Text
    description: str = ""
    steps: Annotated[tuple[Step, ...], Field(min_length=1)]
