"""The plan of a study: the YAML that people write, and the order of its runs."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator
from pydantic.json_schema import SkipJsonSchema

from protocols.steps.base import Number, Positive, SecondsOrNone, StepPart, Text
from protocols.validation import ValidationFault, faults

MOST_RUNS = 10_000
Count = Annotated[int, Field(ge=1, le=MOST_RUNS, strict=True)]
Levels = Annotated[tuple[Number, ...], Field(min_length=1)]


class Conditioning(StepPart):
    """Cycles that a specimen makes before its runs, so that they begin alike (Mullins effect)."""

    protocol: Text
    settings: dict[str, Number] = Field(default={}, description="values of the protocol's parameters")
    before: Literal["run", "block"] = Field(
        default="run", description="each run; or the first run of each block, and the first after an interruption"
    )


class StopRules(StepPart):
    """What ends the study before its last run."""

    failed_runs: Count = Field(default=1, description="runs in succession that a fault or a limit ended")
    mean_error_mm: Positive | SkipJsonSchema[None] = Field(
        default=None, description="a run with a larger mean error between measured and modelled tip"
    )


class StudyPlan(StepPart):
    """A study: every combination of the factors with every item of `combinations`, repeated."""

    title: Text
    description: str = ""
    protocol: Text = Field(description="name, or a file from this file's folder")
    factors: dict[str, Levels] = Field(
        default={}, description="levels by parameter of the protocol; all are combined with each other"
    )
    combinations: tuple[dict[str, Number], ...] = Field(
        default=(), description="values by parameter of the protocol, for parameters that change together"
    )
    repeats: Count = Field(default=1, description="runs of each combination")
    blocks: Count = Field(default=1, description="parts of the study with equally many runs of each combination")
    order: Literal["random", "listed"] = Field(default="random", description="of the runs in each block")
    seed: Annotated[int, Field(ge=0, le=2**31, strict=True)] = Field(
        default=0, description="of the random order; simulated runs have this seed plus their number"
    )
    rest_s: SecondsOrNone = Field(default=0.0, description="between two runs, valves in their safe state")
    conditioning: Conditioning | SkipJsonSchema[None] = None
    block_prompt: Text | SkipJsonSchema[None] = Field(
        default=None, description="what the operator does before each block; the study waits"
    )
    stop: StopRules = StopRules()

    @model_validator(mode="after")
    def _check(self) -> StudyPlan:
        found: list[ValidationFault] = []
        if self.repeats % self.blocks:
            found.append(ValidationFault(("blocks",), f"a divisor of the {self.repeats} repeats"))
        for name, levels in self.factors.items():
            if len(set(levels)) < len(levels):
                found.append(ValidationFault(("factors", name), "each level once"))
        names = set(self.combinations[0]) if self.combinations else set()
        for index, settings in enumerate(self.combinations):
            if set(settings) != names:
                expected = f"values for {', '.join(sorted(names)) or 'nothing'}, as the first one has"
                found.append(ValidationFault(("combinations", index), expected))
            elif settings in self.combinations[:index]:
                found.append(ValidationFault(("combinations", index), "each combination once"))
        both = sorted(names & set(self.factors))
        found += [ValidationFault(("factors", name), "no name of `combinations`") for name in both]
        if (count := len(self.settings()) * self.repeats) > MOST_RUNS:
            found.append(ValidationFault(("repeats",), f"at most {MOST_RUNS} runs; these are {count}"))
        faults(found)
        return self

    @property
    def conditioning_each_run(self) -> bool:
        """Whether conditioning comes before each run, not only before each block."""
        return self.conditioning is not None and self.conditioning.before == "run"

    def settings(self) -> list[dict[str, float]]:
        """The settings of every combination, the last factor changing first."""
        levels = [dict(zip(self.factors, values, strict=True)) for values in product(*self.factors.values())]
        return [{**together, **single} for together in self.combinations or ({},) for single in levels]


@dataclass(frozen=True)
class PlannedRun:
    """A run of a study: number, combination and block count from 1."""

    number: int
    combination: int
    block: int


def planned_runs(plan: StudyPlan) -> tuple[PlannedRun, ...]:
    """The runs in their order: a randomised block design, in which each block is permuted (PCG64 by the seed)."""
    random = np.random.default_rng(plan.seed)
    each = list(range(1, len(plan.settings()) + 1)) * (plan.repeats // plan.blocks)
    runs: list[PlannedRun] = []
    for block in range(1, plan.blocks + 1):
        order = random.permutation(each).tolist() if plan.order == "random" else each
        runs += [PlannedRun(len(runs) + place, combination, block) for place, combination in enumerate(order, 1)]
    return tuple(runs)
