"""The processes that open the driver under test: one for each check, and one that stands by to write the safe state.

`python -m rig.conformance.child check|stand-by DESCRIPTOR PARENT JOB` sends messages to the descriptor and takes
requests from standard input. The process that stands by has loaded everything before the first check begins. It writes
the safe state when it is asked, and of its own accord when the process that asks is gone.
"""

from __future__ import annotations

import faulthandler
import os
import resource
import signal
import sys
import time
from contextlib import closing
from pathlib import Path

from rig.config import loader
from rig.config.schema import RigConfig
from rig.conformance.card_checks import CARD_CHECKS
from rig.conformance.card_subject import CardSubject
from rig.conformance.check import CheckResult, CheckVerdict
from rig.conformance.messages import WHERE, CheckJob, Sender, end_with, message
from rig.conformance.source_checks import CAMERA_CHECKS, TRACKER_CHECKS, SourceSubject
from rig.conformance.timing import DEFAULT_TIMING
from rig.hardware.cards.base import CardError, card_type
from rig.hardware.safe_state import cards_with_outputs, open_safe_state

_RETRY_S = 0.01


def _check(sender: Sender, job: CheckJob) -> None:
    config = loader.load(job.rig_file)
    sender.send(ready=True)
    result = _result(sender, job, config)
    sender.send(verdict=result.verdict, found=result.found)


def _result(sender: Sender, job: CheckJob, config: RigConfig) -> CheckResult:
    device = f"{job.kind} {job.device}"
    if job.kind != "card":
        checks = CAMERA_CHECKS if job.kind == "camera" else TRACKER_CHECKS
        source = next(check for check in checks if check.name == job.check)
        return source.result(device, SourceSubject(config, job.device))

    def unplug() -> None:
        sender.send(unplug=True)
        sys.stdin.readline()

    check = next(check for check in CARD_CHECKS if check.name == job.check)
    vanish = unplug if job.unplugs else None
    subject = CardSubject(config, job.device, Path(job.rig_file), vanish, job.timing)
    if check is CARD_CHECKS[0]:
        try:
            subject.open().close()
        except CardError as error:
            sender.send(unopened=True)
            found = f"{type(error).__name__}: {error}"
            return CheckResult(device, check.name, CheckVerdict.FAIL, found, check.expected)
        except Exception:  # the check reports what the driver raises
            pass
    return check.result(device, subject)


def _stand_by(sender: Sender, rig_file: str) -> None:
    """Write the safe state of each card that a line of standard input names; of all at its end, until `end`."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    config = loader.load(rig_file)
    for name in cards_with_outputs(config):
        card_type(config.cards[name])
    sender.send(ready=True)
    for line in sys.stdin:
        request = message(line)
        if "end" in request:
            return
        sender.send(failure=_made_safe(config, request["card"], request["freed_s"]))
    for name in cards_with_outputs(config):
        _made_safe(config, name, DEFAULT_TIMING.freed_s)


def _made_safe(config: RigConfig, card: str, freed_s: float) -> str:
    """Open a card anew, write its safe state and read it back, for `freed_s`; return why it failed, empty if not."""
    until = time.monotonic() + freed_s
    while True:
        try:
            with closing(open_safe_state(config, card)) as opened:
                opened.arm()
        except (Exception, SystemExit) as error:  # the code of another package may raise anything
            if time.monotonic() > until:
                return str(error) or type(error).__name__
            time.sleep(_RETRY_S)
        else:
            return ""


def _limit_memory() -> None:
    """Let a driver that fills the memory fail, before the kernel ends other processes for it."""
    half = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (half if hard == resource.RLIM_INFINITY else min(half, hard), hard))


def main(mode: str, descriptor: str, parent: str, job: str) -> None:
    """Serve one mode, and end without the clean-up of a driver."""
    sender = Sender(int(descriptor))
    faulthandler.register(WHERE, all_threads=False)
    if mode == "check":
        end_with(int(parent))
        _limit_memory()
        _check(sender, CheckJob.of(job))
    else:
        _stand_by(sender, job)
    os._exit(0)


if __name__ == "__main__":
    main(*sys.argv[1:])
