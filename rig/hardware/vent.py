"""Vents a rig from another process, in every state of its run."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from dataclasses import dataclass

from rig.config.schema import RigConfig
from rig.hardware.cards.base import CardBusyError, CardError
from rig.hardware.lock import described, held_by_unseen, holders
from rig.hardware.safe_state import SafeOutputs, cards_with_outputs, open_outputs, safe_outputs
from rig.hardware.vent_verification import LONGEST_VENTING_S, verify_venting

REPEATED_S = 0.25
NOTICED_S = 0.1
"""Time for a run to detect the external write in its next cycle; after it the holders of the rig get SIGTERM."""
PAUSE_S = 0.002
PATIENCE_S = 0.5
"""How long a process may keep the card: a watchdog needs a moment, another `rig vent` 0.25 s."""
FREED_S = 2.0
ENDED_S = 3.0
LOOK_S = 0.02
_STOP_IT = "it may move the valves again; shut the air off, and stop it as its user or as root"


@dataclass(frozen=True)
class VentResult:
    """A vented rig: the cards without read-back, and how the pressures confirm it; empty for a simulated card."""

    unverified: tuple[str, ...]
    confirmation: str = ""


def vent(config: RigConfig) -> VentResult:
    """Write the vented state to every card repeatedly, for longer than a control period; watch the chambers empty.

    A running experiment detects the external write and ends; a write of its current cycle is overwritten. A run that
    has not begun, has stalled, or whose valves are vented already, gets SIGTERM. A run with a card that allows one
    process only gets SIGTERM at once, and a process that still has the card after that is killed. If the safe state
    holds valves, the end of the run is awaited.

    Raises:
        CardError: a card cannot be opened or written, an output does not keep its value, a camera trigger cannot be
            set low, the pressures do not confirm it, or a process that holds the rig continues and cannot be signalled;
            the other cards are vented nevertheless.
    """
    running = bool(holders(config))
    unsignalled: set[int] = set()
    unverified, failures = _vent(config, unsignalled)
    if running and safe_outputs(config) != safe_outputs(config, vent=True):
        # After a killed process the watchdog writes the safe state, which holds valves.
        _wait_for_end(config, set(holders(config)))
        unverified, failures = _vent(config, unsignalled)
    if staying := _wait_for_end(config, unsignalled):
        failures += [f"{described(pid)} still runs and cannot be stopped: {_STOP_IT}" for pid in staying]
    elif held_by_unseen(config):
        failures.append(f"a process that this one cannot see, as in a container, holds the rig: {_STOP_IT}")
    if failures:
        raise CardError("; ".join(failures))
    return VentResult(unverified, _confirmation(config))


def _confirmation(config: RigConfig) -> str:
    """How the pressures confirm that the chambers are empty; raises CardError where they do not."""
    if all(card.is_mock for card in config.cards.values()):
        return ""  # the pressures of a simulated card exist during a run only, which confirms them itself
    # A run that ends reads its inputs until its chambers are empty, and so reports them, too.
    until = time.monotonic() + LONGEST_VENTING_S
    while holders(config) and time.monotonic() < until:
        time.sleep(LOOK_S)
    outcome = verify_venting(config, vent=True)
    if not outcome.confirmed:
        raise CardError(outcome.sentence)
    return outcome.sentence


def _wait_for_end(config: RigConfig, pids: set[int]) -> set[int]:
    """Wait until these processes release the rig, with a time-out; return those that have not."""
    until = time.monotonic() + ENDED_S
    while (staying := pids & set(holders(config))) and time.monotonic() < until:
        time.sleep(LOOK_S)
    return staying


def _vent(config: RigConfig, unsignalled: set[int]) -> tuple[tuple[str, ...], list[str]]:
    """Vent for REPEATED_S; return the cards without read-back, and the failures of cards and outputs.

    Holders that this user may not signal are added to `unsignalled`.
    """
    opened: list[SafeOutputs] = []
    unverified: list[str] = []
    failures: list[str] = []
    try:
        _open(config, opened, failures, unsignalled)
        _vent_repeatedly(opened, NOTICED_S)
        unsignalled |= _request_end(config)
        _vent_repeatedly(opened, REPEATED_S - NOTICED_S)
        for outputs in opened:
            try:
                unverified += outputs.arm(vent=True)
            except CardError as error:
                failures.append(str(error))
            if outputs.trigger_failure:
                failures.append(outputs.trigger_failure)
    finally:
        for outputs in opened:
            outputs.close()
    return tuple(unverified), failures


def _open(config: RigConfig, opened: list[SafeOutputs], failures: list[str], unsignalled: set[int]) -> None:
    """Open every card and vent it at once; a card that is missing or in use does not delay the others."""
    began = time.monotonic()
    seen: dict[int, float] = {}
    requested = False
    closed = list(cards_with_outputs(config))
    while closed:
        for card in tuple(closed):
            try:
                opened.append(open_outputs(config, card))
            except CardBusyError as busy:
                if time.monotonic() - began < FREED_S:
                    if not requested:
                        requested = True
                        unsignalled |= _request_end(config)
                    _kill_overdue(busy.holders, seen)
                    continue
                failures.append(str(busy))
            except CardError as error:
                failures.append(str(error))
            closed.remove(card)
        _vent_repeatedly(opened, 0.0)
        if closed:
            time.sleep(PAUSE_S)


def _kill_overdue(holders: tuple[int, ...], seen: dict[int, float]) -> None:
    """Kill processes that have kept a card longer than PATIENCE_S; `seen` maps holders to the time of first sight."""
    now = time.monotonic()
    for holder in holders:
        if now - seen.setdefault(holder, now) > PATIENCE_S:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(holder, signal.SIGKILL)


def _request_end(config: RigConfig) -> set[int]:
    """Send SIGTERM to the holders of the rig; return those that this user may not signal."""
    refused = set()
    for holder in holders(config):
        try:
            os.kill(holder, signal.SIGTERM)
        except ProcessLookupError:
            continue
        except PermissionError:
            refused.add(holder)
    return refused


def _vent_repeatedly(opened: list[SafeOutputs], seconds: float) -> None:
    until = time.monotonic() + seconds
    while True:
        for outputs in opened:
            with contextlib.suppress(CardError):  # the final `arm` reports failures
                outputs.make_safe(vent=True)
        if time.monotonic() >= until:
            return
        time.sleep(PAUSE_S)
