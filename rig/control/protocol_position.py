"""Where in the protocol a run is: protocol time runs with the clock, stands still for prompts and pauses, and skips."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class ProtocolPosition:
    """Position in the protocol: its time and how many prompts lie behind it; `waiting` for the operator or not."""

    protocol_s: float = 0.0
    prompts_passed: int = 0
    waiting: bool = False


def advance(
    position: ProtocolPosition, dt_s: float, prompts_s: Sequence[float], answered: int, held: bool
) -> ProtocolPosition:
    """Move on by `dt_s`, stopping at the next unanswered prompt.

    `prompts_s` are the prompts' times in ascending order, `answered` how many of them the operator has answered,
    `held` whether the run is paused.
    """
    if held:
        return ProtocolPosition(position.protocol_s, position.prompts_passed, position.waiting)
    target = position.protocol_s + dt_s
    passed = position.prompts_passed
    while passed < len(prompts_s) and prompts_s[passed] <= target:
        if answered <= passed:
            return ProtocolPosition(prompts_s[passed], passed, waiting=True)
        passed += 1
    return ProtocolPosition(target, passed, waiting=False)


def skip(
    position: ProtocolPosition, starts_s: Sequence[float], end_s: float, prompts_s: Sequence[float]
) -> ProtocolPosition:
    """Set protocol time forward to the next of the segments' starts (ascending), or to the end after the last.

    A prompt that waits, or that lies in what is skipped, is taken as done; one at the new place still waits.
    """
    target = next((start for start in starts_s if start > position.protocol_s), end_s)
    behind = sum(at_s < target for at_s in prompts_s)
    return ProtocolPosition(target, max(position.prompts_passed, behind), waiting=False)
