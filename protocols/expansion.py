"""Expands protocol steps to a trajectory: repeats are unrolled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from protocols.problems import Problem
from protocols.schema import InnerSteps, Step, leaves
from protocols.source_positions import Document
from protocols.steps.base import MOST_SEGMENTS, LeafStep
from protocols.tip_inverse import TipInverse
from protocols.trajectory import SetPointTrajectory
from protocols.trajectory_builder import Path, TrajectoryBuilder


def too_long(steps: Sequence[Step], document: Document) -> list[Problem]:
    """Problems of steps that expand to more than `MOST_SEGMENTS` segments; found without expanding them."""
    found: list[Problem] = []
    _count(steps, ("steps",), document, found)
    return found


def _count(steps: Sequence[Step], base: Path, document: Document, found: list[Problem]) -> int:
    total = 0
    for index, step in enumerate(steps):
        body, at = step.body, (*base, index, step.kind)
        if isinstance(body, InnerSteps):
            count = body.times * _count(body.steps, (*at, *body.path), document, found)
            at = (*at, *body.count_path)
        else:
            count, decisive = body.most_segments
            at = (*at, *decisive)
        if count > MOST_SEGMENTS and not found:
            found.append(document.problem(at, f"less: at most {MOST_SEGMENTS} segments in all, and this makes more"))
        total += count
    if total > MOST_SEGMENTS and not found:
        found.append(
            document.problem(base, f"at most {MOST_SEGMENTS} segments in all; these make {total}", "", at_key=True)
        )
    return total


def expand(
    steps: Sequence[Step],
    actuators: int,
    document: Document,
    data: Mapping[LeafStep, Any],
    inverse: TipInverse | None = None,
) -> SetPointTrajectory:
    """The trajectory for a rig with N actuators; `BadInputError` if a step names an unknown one.

    data: results of `LeafStep.read`. inverse: solves for the set-points of `tip` steps.
    """
    builder = TrajectoryBuilder(actuators, document, data, inverse)
    for here, body in leaves(steps, unrolled=True):
        if builder.begin(here, getattr(body, "actuators", None) or ()):
            body.play(builder)
    return builder.trajectory()
