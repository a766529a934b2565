"""A prompt to the operator."""

from __future__ import annotations

from pydantic import Field
from pydantic.json_schema import SkipJsonSchema

from protocols.steps.base import Grams, LeafStep, Text
from protocols.trajectory_builder import TrajectoryBuilder

PROMPT_S = 0.1
"""Duration of a prompt's segment, in which the set-points are constant."""


class PromptStep(LeafStep):
    """What the operator has to do; the run waits until it is confirmed. With `weight_g` the model, and a simulated
    arm, carry that weight on the end cap from then on; without, what hangs there stays.
    """

    message: Text
    weight_g: Grams | SkipJsonSchema[None] = Field(default=None, description="hung on the end cap from now on")

    def play(self, builder: TrajectoryBuilder) -> None:
        """A short segment of constant set-points, and the prompt at its start."""
        builder.prompt(self.message, self.weight_g)
        builder.hold("prompt", self.message, (), PROMPT_S)
