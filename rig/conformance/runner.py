"""Runs the conformance tests on the devices of a rig: each check in a process of its own, then the safe state."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rig.config.drivers import Reality
from rig.config.schema import RigConfig
from rig.conformance.card_checks import CARD_CHECKS
from rig.conformance.check import Check, CheckResult, CheckVerdict
from rig.conformance.messages import CheckJob
from rig.conformance.process import Child, HangsError, NoAnswerError, StopRequestedError
from rig.conformance.source_checks import CAMERA_CHECKS, TRACKER_CHECKS
from rig.conformance.timing import DEFAULT_TIMING, CheckTiming
from rig.hardware.lock import cards_locked
from rig.simulator.plant_launcher import simulated
from rig.simulator.registers import Registers

Unplug = Callable[[str], None]
"""Makes a card disappear, by its name."""
ENDLESS = 2**40
SAFE_S = 5.0
"""Time to open a card and to write it, beyond the time for one whose process was killed."""
UNSAFE = "the safe state could not be written afterwards"
SHUT_OFF = "shut the air off by hand"


class Conformance:
    """Checks of the devices of one rig, whose cards are locked and whose simulated devices run."""

    def __init__(
        self, config: RigConfig, rig_file: Path, timing: CheckTiming, unplug: Unplug | None, stop: Callable[[], bool]
    ) -> None:
        """`stop` is asked repeatedly; the check that runs then ends, with the safe state."""
        self._config, self._rig_file, self._timing = config, Path(rig_file).absolute(), timing
        self._unplug, self._stop = unplug, stop
        self._stand_by: Child | None = None
        self._unplugged = False
        self.given_up = ""
        """Why further checks of the same device would tell nothing; empty if they would."""
        self.stopped = False

    def run(self, kind: str, name: str, check: Check[Any]) -> CheckResult:
        """Run a check of a device; of a card, write its safe state then, by a fresh opening in another process."""
        if kind != "card":
            return self._checked(kind, name, check)
        try:
            self._standing_by()
        except NoAnswerError as error:
            self.given_up = "no process can stand by to write the safe state"
            found = f"{self.given_up}: {error}"
            return CheckResult(f"{kind} {name}", check.name, CheckVerdict.FAIL, found, check.expected)
        try:
            result = self._checked(kind, name, check)
        finally:
            failure = self._make_safe(name)
        if not failure or self._unplugged:
            return result
        found = f"{result.found}; {UNSAFE} ({failure}): {SHUT_OFF}"
        return CheckResult(result.device, result.check, CheckVerdict.FAIL, found, result.expected)

    def close(self) -> None:
        """End the process that stands by."""
        if self._stand_by is not None:
            self._stand_by.tell(end=True)
        self._drop_stand_by()

    def _checked(self, kind: str, name: str, check: Check[Any]) -> CheckResult:
        self.given_up, self._unplugged = "", False
        verdict, found = CheckVerdict.FAIL, ""
        unplug = self._unplug_of(name) if kind == "card" else None
        job = CheckJob(str(self._rig_file), kind, name, check.name, self._timing, unplug is not None)
        child = Child("check", job.text())
        try:
            child.answer(self._timing.start_s, self._stop)
            while "verdict" not in (answer := child.answer(self._timing.check_s, self._stop)):
                if "unplug" in answer and unplug is not None:
                    unplug()
                    self._unplugged = True
                    child.tell(unplugged=True)
                if "unopened" in answer:
                    self.given_up = f"the {kind} cannot be opened"
            verdict, found = CheckVerdict(answer["verdict"]), answer["found"]
        except NoAnswerError as error:
            found = str(error)
            if isinstance(error, HangsError):
                self.given_up = f"{check.name} did not end"
        except StopRequestedError:
            self.stopped = True
            verdict, found = CheckVerdict.SKIPPED, "interrupted"
        finally:
            child.close()
        return CheckResult(f"{kind} {name}", check.name, verdict, found, check.expected)

    def _standing_by(self) -> Child:
        """The process that stands by, which has loaded everything."""
        if self._stand_by is None:
            self._stand_by = child = Child("stand-by", str(self._rig_file))
            try:
                child.answer(self._timing.start_s)
            except NoAnswerError:
                self._drop_stand_by()
                raise
        return self._stand_by

    def _drop_stand_by(self) -> None:
        if self._stand_by is not None:
            self._stand_by.close()
            self._stand_by = None

    def _make_safe(self, card: str) -> str:
        """Write the safe state of a card; return why that failed, empty if it did not."""
        freed_s = self._timing.freed_s
        try:
            stand_by = self._standing_by()
            stand_by.tell(card=card, freed_s=freed_s)
            return str(stand_by.answer(freed_s + SAFE_S)["failure"])
        except NoAnswerError as error:
            self._drop_stand_by()
            return str(error)

    def _unplug_of(self, card: str) -> Callable[[], None] | None:
        """What makes a card disappear; a mock card by a fault of the simulator."""
        section = self._config.cards[card]
        if section.reality is Reality.SIMULATED:
            return lambda: _break(section.device)
        unplug = self._unplug
        return None if unplug is None else lambda: unplug(card)


@contextmanager
def conformance(
    config: RigConfig,
    rig_file: Path,
    unplug: Unplug | None = None,
    timing: CheckTiming = DEFAULT_TIMING,
    stop: Callable[[], bool] = lambda: False,
) -> Iterator[Conformance]:
    """Lock the cards of a rig and run the simulator of its mock devices.

    Raises:
        CardError: another run holds a card, or the simulator does not start.
    """
    with cards_locked(config, "rig test-driver"), simulated(config, rig_file, seed=0):
        checks = Conformance(config, rig_file, timing, unplug, stop)
        try:
            yield checks
        finally:
            checks.close()


def results(
    config: RigConfig,
    rig_file: Path,
    unplug: Unplug | None = None,
    timing: CheckTiming = DEFAULT_TIMING,
    stop: Callable[[], bool] = lambda: False,
) -> Iterator[CheckResult]:
    """Check every camera, tracker and card of a rig, one result at a time.

    Each check of a card ends with its safe state. Once `stop` returns True, the check that runs is the last one.

    Raises:
        CardError: another run holds a card, or the simulator does not start.
    """
    devices: list[tuple[str, str, tuple[Check[Any], ...]]] = [
        *(("camera", name, CAMERA_CHECKS) for name in config.cameras),
        *(("tracker", name, TRACKER_CHECKS) for name in config.trackers),
        *(("card", name, CARD_CHECKS) for name in config.cards),
    ]
    with conformance(config, rig_file, unplug, timing, stop) as checks:
        for kind, name, of_kind in devices:
            for left, check in zip(range(len(of_kind) - 1, -1, -1), of_kind, strict=True):
                yield checks.run(kind, name, check)
                if checks.stopped:
                    return
                if checks.given_up and left:
                    why = f"not run: {checks.given_up}"
                    yield CheckResult(f"{kind} {name}", f"{left} more", CheckVerdict.SKIPPED, why, "")
                    break


def _break(device: str) -> None:
    """Let every read and write of a mock card fail."""
    registers = Registers.attach(device)
    registers.faults.inject(failing_reads=ENDLESS, failing_writes=ENDLESS)
    registers.close()
