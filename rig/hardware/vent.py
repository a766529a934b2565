"""Venting a rig from outside, whatever its run is doing."""

from __future__ import annotations

import contextlib
import os
import signal
import time

from rig.config.schema import RigConfig
from rig.control.step import safe_voltages
from rig.hardware.bench import Bench, cards_with_valves, open_outputs
from rig.hardware.cards.base import CardBusyError, CardError
from rig.hardware.lock import described, held_by_unseen, holders

REPEATED_S = 0.25
NOTICED_S = 0.1
"""A run that goes finds its valves moved at its next tick, and says so; who has not by then is told."""
PAUSE_S = 0.002
PATIENCE_S = 0.5
"""A watchdog that is making the card safe has it for a moment only, another `rig vent` for a quarter of a second."""
FREED_S = 2.0
ENDED_S = 3.0
LOOK_S = 0.02
_STOP_IT = "it may move the valves again; shut the air off, and stop it as its user or as root"


def vent(config: RigConfig) -> None:
    """Write the vented state to every card, again and again for a while: longer than any control period.

    A run that goes finds its valves where it did not put them, and ends. One that has just looked writes once more,
    and is overwritten. One that has not begun, that stands still, or whose valves stand there anyway, is told to end
    (SIGTERM). One that has a card that lets in one process at a time is told to end at once, and the process that
    still has the card after that is killed. Where valves would be held the run's end is waited for.

    Raises:
        CardError: a card cannot be opened or written, an output does not stay where it was told to, or a process that
            holds the rig goes on and cannot be told to end; the other cards are vented all the same.
    """
    running = bool(holders(config))
    untold: set[int] = set()
    failures = _vent(config, untold)
    if running and safe_voltages(config) != safe_voltages(config, vent=True):
        # Who comes after a process that was killed knows nothing of this, and writes what is held.
        _wait_for_end(config, set(holders(config)))
        failures = _vent(config, untold)
    if staying := _wait_for_end(config, untold):
        failures += [f"{described(pid)} goes on and cannot be told to end: {_STOP_IT}" for pid in staying]
    elif held_by_unseen(config):
        failures.append(f"a process that this one cannot see, as in a container, holds the rig: {_STOP_IT}")
    if failures:
        raise CardError("; ".join(failures))


def _wait_for_end(config: RigConfig, pids: set[int]) -> set[int]:
    """Wait for a while until these processes let go of the rig; those that have not."""
    until = time.monotonic() + ENDED_S
    while (staying := pids & set(holders(config))) and time.monotonic() < until:
        time.sleep(LOOK_S)
    return staying


def _vent(config: RigConfig, untold: set[int]) -> list[str]:
    """Vent for a while; what kept a card from it, and which outputs do not stand where they were told.

    Holders that may not be told to end are added to `untold`.
    """
    benches: list[Bench] = []
    failures: list[str] = []
    try:
        _open(config, benches, failures, untold)
        _insist(benches, NOTICED_S)
        untold |= _tell_to_end(config)
        _insist(benches, REPEATED_S - NOTICED_S)
        for bench in benches:
            try:
                bench.arm(vent=True)
            except CardError as error:
                failures.append(str(error))
    finally:
        for bench in benches:
            bench.close()
    return failures


def _open(config: RigConfig, benches: list[Bench], failures: list[str], untold: set[int]) -> None:
    """Open every card and vent it as soon as it is open: one that is gone, or in use, keeps no other waiting."""
    began = time.monotonic()
    seen: dict[int, float] = {}
    told = False
    closed = list(cards_with_valves(config))
    while closed:
        for card in tuple(closed):
            try:
                benches.append(open_outputs(config, card))
            except CardBusyError as busy:
                if time.monotonic() - began < FREED_S:
                    if not told:
                        told = True
                        untold |= _tell_to_end(config)
                    _end_who_stay(busy.holders, seen)
                    continue
                failures.append(str(busy))
            except CardError as error:
                failures.append(str(error))
            except Exception as error:  # a card must not keep the others from being vented
                failures.append(f"card {card}: {type(error).__name__}: {error}")
            closed.remove(card)
        _insist(benches, 0.0)
        if closed:
            time.sleep(PAUSE_S)


def _end_who_stay(holders: tuple[int, ...], seen: dict[int, float]) -> None:
    """Kill who has had a card for too long; `seen` is since when. Nobody is seen who has just let go of it."""
    now = time.monotonic()
    for holder in holders:
        if now - seen.setdefault(holder, now) > PATIENCE_S:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(holder, signal.SIGKILL)


def _tell_to_end(config: RigConfig) -> set[int]:
    """Send SIGTERM to whoever holds the rig; those that this user may not signal."""
    refused = set()
    for holder in holders(config):
        try:
            os.kill(holder, signal.SIGTERM)
        except ProcessLookupError:
            continue
        except PermissionError:
            refused.add(holder)
    return refused


def _insist(benches: list[Bench], seconds: float) -> None:
    until = time.monotonic() + seconds
    while True:
        for bench in benches:
            with contextlib.suppress(CardError):  # the last write tells
                bench.make_safe(vent=True)
        if time.monotonic() >= until:
            return
        time.sleep(PAUSE_S)
