"""How long calls into a driver take, and whether the driver or a busy machine makes them long."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from rig.driver_contract.check import BrokenContractError, NotJudgedError

Result = TypeVar("Result")

MOST_SLOW = 0.02
"""Largest share of calls that may take longer than the control period."""
WAKE_UPS = 4
"""Processes and threads that may have to wake up, one after the other, before a device has answered."""
_QUIET = 0.25
"""Share of the control period that a quiet machine adds to a call at most."""
_SCHEDULER = Path("/proc/thread-self/schedstat")


class CallTime(NamedTuple):
    """Duration of a call without the time that this thread waited for a processor, and the processor time used."""

    took_s: float
    processor_s: float


def timed(call: Callable[[], Result]) -> tuple[Result, CallTime]:
    """The result of a call and its time; the whole duration where the system does not tell how long a thread waited."""
    waited_s, used_s, began = _waited_s(), time.thread_time(), time.monotonic()
    result = call()
    took_s, used_s = time.monotonic() - began, time.thread_time() - used_s
    return result, CallTime(max(0.0, took_s - (_waited_s() - waited_s)), used_s)


def idle_wait(until: float) -> float:
    """Wait until a time of `time.monotonic()`; returns how much too late the wait ended [s]."""
    time.sleep(max(0.0, until - time.monotonic()))
    return max(0.0, time.monotonic() - until)


def judged(word: str, calls: Sequence[CallTime], late_s: Sequence[float], period_s: float) -> str:
    """The figures of calls that may take a control period at most.

    `late_s` tells how much too late idle waits beside the calls ended: as late may be each wake-up inside a call.

    Raises:
        BrokenContractError: the driver takes longer.
        NotJudgedError: the calls take longer, and so they might because the machine is busy.
    """
    took, late = np.array([call.took_s for call in calls]), np.array(late_s)
    figures = f"{word} {np.median(took) * 1e3:.2f} ms, 90 % {np.quantile(took, 0.9) * 1e3:.2f} ms, "
    figures += f"longest {took.max() * 1e3:.2f} ms"
    if not (fault := _fault(word, took, period_s)):
        return figures
    often_s, typical_s = (WAKE_UPS * float(np.quantile(late, share)) for share in (1 - MOST_SLOW, 0.5))
    processor = np.array([call.processor_s for call in calls])
    certain = _fault(word, processor, period_s) or _fault(word, took - often_s, period_s)
    if often_s < _QUIET * period_s or certain or np.median(took) - typical_s > period_s:
        raise BrokenContractError(f"{figures}; {fault}")
    raise _machine_busy(late, figures)


class ScanTimes(NamedTuple):
    """What is known of the scans of some control periods.

    `number` of them within `span_s` from the first to the last; their youngest age `age_s`; the duration of all
    `taken_s`; `late_s`, how much too late the idle waits between the reads ended.
    """

    number: int
    span_s: float
    age_s: float
    taken_s: float
    late_s: Sequence[float]


def judge_scans(scans: ScanTimes, least_hz: float, stale_s: float) -> None:
    """Check that scans come often and soon enough.

    Raises:
        BrokenContractError: they do not.
        NotJudgedError: they do not, and so they might because the machine is busy.
    """
    late = np.array(scans.late_s)
    typical_s = WAKE_UPS * float(np.median(late))
    left_s = scans.taken_s - WAKE_UPS * float(late.sum())
    rate = (scans.number - 1) / scans.span_s if scans.number > 1 else 0.0
    if scans.number < 2:
        fault, certain = f"{scans.number} scans in {scans.taken_s:.2g} s", True
    elif scans.age_s > stale_s:
        fault = (
            f"the newest scan is {scans.age_s * 1e3:.0f} ms old at best; a run stops at {stale_s * 1e3:g} ms (stale_s)"
        )
        certain = scans.age_s - typical_s > stale_s
    elif rate < least_hz:
        fault = f"{rate:.0f} scans/s; control runs at {2 * least_hz:g} Hz"
        certain = scans.number < least_hz * left_s
    else:
        return
    raise BrokenContractError(fault) if certain else _machine_busy(late, fault)


def _machine_busy(late_s: NDArray[np.float64], figures: str) -> NotJudgedError:
    idle = f"idle waits end up to {np.quantile(late_s, 1 - MOST_SLOW) * 1e3:.2f} ms late (98 %)"
    return NotJudgedError(f"machine busy: {idle}; {figures}")


def _fault(word: str, took_s: NDArray[np.float64], period_s: float) -> str:
    """What is wrong with these durations; empty if nothing is."""
    if np.quantile(took_s, 0.9) > period_s:
        return f"the control period is {period_s * 1e3:g} ms"
    slow = int((took_s > period_s).sum())
    if slow > max(1.0, MOST_SLOW * len(took_s)):
        return f"{slow} of {len(took_s)} calls of {word} take longer than the control period"
    return ""


def _waited_s() -> float:
    """Time [s] that this thread was ready to run and did not."""
    try:
        return int(_SCHEDULER.read_text().split()[1]) * 1e-9
    except (OSError, ValueError, IndexError):
        return 0.0
