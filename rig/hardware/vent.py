"""Vents rigs from another process, in every state of their runs."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Iterable
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial

from rig.config.bench import BenchConfig, VentedBench
from rig.hardware.call_limit import LONGEST_CALL_S, awaited, begun, within
from rig.hardware.cards.base import AbsentCardError, CardBusyError, CardError
from rig.hardware.lock import described, held_by_unseen, holders, runs_of
from rig.hardware.running import signal_run
from rig.hardware.safe_state import SafeOutputs, SafeState, cards_with_outputs, open_safe_state
from rig.hardware.vent_verification import LONGEST_VENTING_S, UNCONFIRMED, verify_venting

REPEATED_S = 0.25
NOTICED_S = 0.1
"""Time for a run to detect the external write in its next cycle; after it the holders of the rig get SIGTERM."""
PAUSE_S = 0.002
PATIENCE_S = 0.5
"""How long a process may keep the card: a watchdog needs a moment, another `rig vent` 0.25 s."""
FREED_S = 2.0
"""How long a card that admits one process is awaited: its holder gets SIGTERM, and is killed after PATIENCE_S."""
ENDED_S = 3.0
"""How long the end of a run is awaited: more than control and watchdog take to make the valves safe."""
LOOK_S = 0.02
_STOP_IT = "it may move the valves again; shut the air off, and stop it as its user or as root"


@dataclass(frozen=True)
class VentResult:
    """What came of venting a rig.

    The cards without read-back, how the pressures confirm it (empty for a simulated card), and what has failed.
    `gone`: the cards were simulated by a run that has ended, or that has not made them.
    """

    unverified: tuple[str, ...] = ()
    confirmation: str = ""
    failures: tuple[str, ...] = ()
    gone: bool = False


def vent(config: BenchConfig) -> tuple[VentResult, ...]:
    """Vent a rig, and the runs of a simulated one, of which each has cards of its own; see `Venting`.

    Raises:
        CardError: a card cannot be opened or written, an output does not keep its value, a camera trigger cannot be
            set low, the pressures do not confirm it, or a process that holds the rig continues and cannot be signalled;
            the other cards are vented nevertheless.
    """
    runs = runs_of(config)
    for run in runs:
        signal_run(run)
    rigs = [Venting(VentedBench.model_validate(run.bench), of_run=True) for run in runs]
    if not rigs or config.has_real_valves:
        rigs.append(Venting(config))
    for rig in rigs:
        rig.begin()
    found = results(rigs)
    if failures := [failure for result in found for failure in result.failures]:
        raise CardError("; ".join(failures))
    return tuple(found)


def results(rigs: Iterable[Venting]) -> list[VentResult]:
    """The results of rigs whose venting has begun: every rig is written before the first is confirmed."""
    begun_rigs = list(rigs)
    for rig in begun_rigs:
        rig.finish_writing()
    for rig in begun_rigs:
        rig.vent_held_valves()
    return [rig.result() for rig in begun_rigs]


class Venting:
    """The venting of one rig: writes the vented state to every card repeatedly, for longer than a control period.

    A running experiment detects the external write and ends; a write of its current cycle is overwritten. A run that
    has not begun, has stalled, or whose valves are vented already, gets SIGTERM. A run with a card that allows one
    process only gets SIGTERM at once, and a process that still has the card after that is killed. If the safe state
    holds valves, the end of the run is awaited. Each card has a thread: one that is missing, in use or hangs does not
    delay the others.
    """

    def __init__(self, config: BenchConfig, *, of_run: bool = False) -> None:
        """`of_run`: the rig is that of a run, which may have ended since."""
        self._config = config
        self._running = bool(holders(config))
        self._of_run = of_run or self._running
        self._unsignalled: set[int] = set()
        self._cards: dict[str, Future[_CardOutcome]] = {}
        self._began = time.monotonic()
        self._outcomes: dict[str, _CardOutcome] = {}

    def begin(self) -> None:
        """Begin to write to every card; does not wait."""
        self._began = time.monotonic()
        for name in cards_with_outputs(self._config):
            self._cards[name] = begun(partial(self._vent_card, name))

    def finish_writing(self) -> None:
        """Wait until every card has been written and read back, or has failed."""
        for name, card in self._cards.items():
            try:
                outcome = awaited(card, max(0.1, self._began + LONGEST_CALL_S - time.monotonic()))
            except Exception as error:  # whatever a driver raises: the other cards are vented
                outcome = _CardOutcome(failures=(f"card {name}: {error}",))
            self._outcomes[name] = outcome
        self._request_end()

    def vent_held_valves(self) -> None:
        """Wait for the end of a run whose safe state holds valves, and vent again.

        After a killed process the watchdog writes the safe state.
        """
        if self._running and SafeOutputs.of(self._config.valves).holds.any():
            self._wait_for_end(set(holders(self._config)))
            self.begin()
            self.finish_writing()

    def result(self) -> VentResult:
        """What came of it, confirmed by the pressures of a real rig."""
        outcomes = self._outcomes.values()
        failures = [failure for outcome in outcomes for failure in outcome.failures]
        if staying := self._wait_for_end(self._unsignalled):
            failures += [f"{described(pid)} still runs and cannot be stopped: {_STOP_IT}" for pid in sorted(staying)]
        elif held_by_unseen(self._config):
            failures.append(f"a process that this one cannot see, as in a container, holds the rig: {_STOP_IT}")
        unverified = tuple(name for outcome in outcomes for name in outcome.unverified)
        if failures:
            return VentResult(unverified, failures=tuple(failures))
        if all(outcome.absent for outcome in outcomes):
            return VentResult(gone=True)
        try:
            return VentResult(unverified, _confirmation(self._config))
        except CardError as error:
            return VentResult(unverified, failures=(str(error),))

    def _vent_card(self, name: str) -> _CardOutcome:
        """Vent one card for REPEATED_S and read it back."""
        try:
            card = self._opened(name)
        except CardError as error:
            return _CardOutcome(failures=(str(error),))
        if card is None:
            return _CardOutcome(absent=True)
        try:
            _vent_repeatedly(card, NOTICED_S)
            self._request_end()
            _vent_repeatedly(card, REPEATED_S - NOTICED_S)
            failures = []
            unverified: tuple[str, ...] = ()
            try:
                unverified = card.arm(vent=True)
            except CardError as error:
                failures.append(str(error))
            if card.trigger_failure:
                failures.append(card.trigger_failure)
            return _CardOutcome(unverified, tuple(failures))
        finally:
            card.close()

    def _opened(self, name: str) -> SafeState | None:
        """Open a card; None for a simulated card of a run that has ended. Raises CardError."""
        seen: dict[int, float] = {}
        requested = False
        while True:
            waited_s = time.monotonic() - self._began
            try:
                return open_safe_state(self._config, name)
            except AbsentCardError:
                if not self._of_run or waited_s > ENDED_S:
                    raise
                if not holders(self._config):
                    return None
            except CardBusyError as busy:
                if waited_s > FREED_S:
                    raise
                _kill_overdue(busy.holders, seen)
            if not requested:
                requested = True
                self._request_end()
            time.sleep(PAUSE_S)

    def _request_end(self) -> None:
        """Send SIGTERM to the holders of the rig; note those that this user may not signal."""
        for holder in holders(self._config):
            try:
                os.kill(holder, signal.SIGTERM)
            except ProcessLookupError:
                continue
            except PermissionError:
                self._unsignalled.add(holder)

    def _wait_for_end(self, pids: set[int]) -> set[int]:
        """Wait until these processes release the rig, with a time-out; return those that have not."""
        until = time.monotonic() + ENDED_S
        while (staying := pids & set(holders(self._config))) and time.monotonic() < until:
            time.sleep(LOOK_S)
        return staying


@dataclass(frozen=True)
class _CardOutcome:
    """What came of venting a card; `absent`: a simulated card of a run that has ended."""

    unverified: tuple[str, ...] = field(default=())
    failures: tuple[str, ...] = ()
    absent: bool = False


def _confirmation(config: BenchConfig) -> str:
    """How the pressures confirm that the chambers are empty; raises CardError where they do not."""
    if not config.has_real_valves:
        return ""  # the pressures of a simulated card exist during a run only, which confirms them itself
    if not config.sensors:
        raise CardError(f"{UNCONFIRMED}: the rig file states no sensor for each actuator that can be read")
    # A run that ends reads its inputs until its chambers are empty, and so reports them, too.
    until = time.monotonic() + LONGEST_VENTING_S
    while holders(config) and time.monotonic() < until:
        time.sleep(LOOK_S)
    outcome = within(lambda: verify_venting(config, vent=True), LONGEST_VENTING_S + LONGEST_CALL_S)
    if not outcome.confirmed:
        raise CardError(outcome.sentence)
    return outcome.sentence


def _kill_overdue(holders: tuple[int, ...], seen: dict[int, float]) -> None:
    """Kill processes that have kept a card longer than PATIENCE_S; `seen` maps holders to the time of first sight."""
    now = time.monotonic()
    for holder in holders:
        if now - seen.setdefault(holder, now) > PATIENCE_S:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(holder, signal.SIGKILL)


def _vent_repeatedly(card: SafeState, seconds: float) -> None:
    until = time.monotonic() + seconds
    while True:
        with contextlib.suppress(CardError):  # the final `arm` reports failures
            card.make_safe(vent=True)
        if time.monotonic() >= until:
            return
        time.sleep(PAUSE_S)
