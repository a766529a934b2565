"""The protocol clock: protocol time follows the clock, stops for prompts and pauses, and jumps at a skip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class ProtocolPosition:
    """Position in the protocol: protocol time, number of passed prompts, and whether it waits for the operator."""

    protocol_s: float = 0.0
    prompts_passed: int = 0
    waiting: bool = False


def advance(
    position: ProtocolPosition, dt_s: float, prompts_s: Sequence[float], prompts_answered: int, paused: bool
) -> ProtocolPosition:
    """Advance by `dt_s`, at most to the next unanswered prompt.

    `prompts_s` are the prompts' times in ascending order, `prompts_answered` is the number of answered prompts,
    `paused` whether the run is paused.
    """
    if paused:
        return position
    target = position.protocol_s + dt_s
    passed = position.prompts_passed
    while passed < len(prompts_s) and prompts_s[passed] <= target:
        if prompts_answered <= passed:
            return ProtocolPosition(prompts_s[passed], passed, waiting=True)
        passed += 1
    return ProtocolPosition(target, passed, waiting=False)


def skip(
    position: ProtocolPosition, starts_s: Sequence[float], end_s: float, prompts_s: Sequence[float]
) -> ProtocolPosition:
    """Advance protocol time to the next start of a segment (`starts_s` ascending), or to the end after the last one.

    A waiting prompt and prompts in the skipped part count as answered; a prompt at the new position still waits.
    """
    target = next((start for start in starts_s if start > position.protocol_s), end_s)
    behind = sum(at_s < target for at_s in prompts_s)
    return ProtocolPosition(target, max(position.prompts_passed, behind), waiting=False)
