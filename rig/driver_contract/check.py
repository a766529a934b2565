"""One check of a driver and its result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Generic, TypeVar

from rig.hardware.call_limit import within
from rig.hardware.cards.base import CardError
from rig.hardware.driver_calls import TipSourceError

Subject = TypeVar("Subject")

LONGEST_S = 120.0
"""A check that takes longer waits for a driver that does not return."""


class CheckVerdict(StrEnum):
    """Result of a check."""

    PASS = "pass"
    FAIL = "FAIL"
    SKIPPED = "skipped"
    NOT_JUDGED = "not judged"


class BrokenContractError(Exception):
    """The driver does not do what softrig relies on; the message has what was found."""


class NotApplicableError(Exception):
    """The device lacks what the check needs; the message says what."""


class NotJudgedError(Exception):
    """The figures do not show whether the driver or something else is at fault; the message says what."""


@dataclass(frozen=True)
class CheckResult:
    """Result of one check of one device: `found` has figures or the fault, `expected` what softrig relies on."""

    device: str
    check: str
    verdict: CheckVerdict
    found: str
    expected: str

    @property
    def failed(self) -> bool:
        """True if the driver broke the contract."""
        return self.verdict is CheckVerdict.FAIL


@dataclass(frozen=True)
class Check(Generic[Subject]):
    """A check: `run` returns figures, or raises BrokenContractError, NotApplicableError or NotJudgedError."""

    name: str
    expected: str
    run: Callable[[Subject], str]

    def result(self, device: str, subject: Subject) -> CheckResult:
        """Run the check; whatever the driver raises is a result, and so is a call that does not return."""
        try:
            return within(lambda: self._result(device, subject), LONGEST_S)
        except CardError:
            stuck = f"a call does not return within {LONGEST_S:g} s"
            return CheckResult(device, self.name, CheckVerdict.FAIL, stuck, self.expected)

    def _result(self, device: str, subject: Subject) -> CheckResult:
        try:
            verdict, found = CheckVerdict.PASS, self.run(subject)
        except NotApplicableError as error:
            verdict, found = CheckVerdict.SKIPPED, str(error)
        except NotJudgedError as error:
            verdict, found = CheckVerdict.NOT_JUDGED, str(error)
        except BrokenContractError as error:
            verdict, found = CheckVerdict.FAIL, str(error)
        except (CardError, TipSourceError) as error:
            verdict, found = CheckVerdict.FAIL, f"{type(error).__name__}: {error}"
        except Exception as error:  # the code of another package may raise anything
            verdict, found = (
                CheckVerdict.FAIL,
                f"{type(error).__name__}: {error}; only CardError, CameraError or TrackerError may be raised",
            )
        return CheckResult(device, self.name, verdict, found, self.expected)
