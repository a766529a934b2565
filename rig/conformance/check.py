"""One check of a driver and its result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Generic, TypeVar

from rig.hardware.cards.base import CardError
from rig.hardware.driver_calls import TipSourceError

Subject = TypeVar("Subject")


class CheckVerdict(StrEnum):
    """Result of a check."""

    PASS = "pass"
    FAIL = "FAIL"
    SKIPPED = "skipped"


class NonconformityError(Exception):
    """The driver does not do what softrig relies on; the message has what was found."""


class NotApplicableError(Exception):
    """The device lacks what the check needs; the message says what."""


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
        """True if the driver does not conform."""
        return self.verdict is CheckVerdict.FAIL


@dataclass(frozen=True)
class Check(Generic[Subject]):
    """A check: `run` returns figures, or raises NonconformityError or NotApplicableError."""

    name: str
    expected: str
    run: Callable[[Subject], str]

    def result(self, device: str, subject: Subject) -> CheckResult:
        """Run the check in this process; whatever the driver raises is a result."""
        try:
            verdict, found = CheckVerdict.PASS, self.run(subject)
        except NotApplicableError as error:
            verdict, found = CheckVerdict.SKIPPED, str(error)
        except NonconformityError as error:
            verdict, found = CheckVerdict.FAIL, str(error)
        except (CardError, TipSourceError) as error:
            verdict, found = CheckVerdict.FAIL, f"{type(error).__name__}: {error}"
        except (Exception, SystemExit, KeyboardInterrupt) as error:  # the code of another package may raise anything
            only = "only CardError, CameraError or TrackerError may be raised"
            verdict, found = CheckVerdict.FAIL, f"{type(error).__name__}: {error}; {only}"
        return CheckResult(device, self.name, verdict, found, self.expected)
