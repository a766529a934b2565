"""Trials of faults while a run in real time starts, and while its archive is written."""

from __future__ import annotations

import contextlib
import math
import random
import re
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import rig.config.loader
from rig.hardware.cards.base import CardError
from rig.hardware.lock import cards_locked
from runs.records import Status
from scripts.faults.fault import Fault, FaultTrial, Injection
from scripts.faults.fault_trial import EndedBeforeError, archive
from scripts.faults.injections import KILL, STOP
from scripts.faults.trial_run import PLANT, START_S, SUPERVISOR, TrialRun, run_processes

DURATION_S = 0.6
PROTOCOL = f"""
title: Soon over
steps:
  - ramp: {{actuators: [1, 2, 3], to_bar: 0.3, duration_s: {DURATION_S}}}
"""
FAULT_DELAY_S = 0.5
"""Longest time from the start of a process, or from the safe state, to the fault."""
STOPPED_S = 4.0
GONE_S, LEFT_S = 60.0, 12.0
"""Time limits for the run to end, and for its remaining processes after that."""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
MESSAGES = "stopped before the run began|process died|before the run began|silent|hung|interrupted|Interrupt|is in use"


class TransitionAction(Enum):
    """Actions on a run while it starts or ends."""

    KILLED_OR_STOPPED = "one to three of its processes killed or stopped"
    SIGNALLED = "Ctrl-C, SIGTERM or SIGHUP, one to three of them"
    VENT = "rig vent"


@dataclass(frozen=True)
class TransitionFault(Injection):
    """An action while the run starts, or while it ends: the valves are safe and the archive is not yet written."""

    ending: bool
    action: TransitionAction

    def trial(self, fault: Fault, folder: Path, at_s: float, seed: int) -> FaultTrial:
        """Run one trial, and check what the run leaves behind."""
        chance = random.Random(seed)
        run = TrialRun(folder, protocol=PROTOCOL)
        try:
            _wait(run, self, chance.randint(0, 4))
            time.sleep(chance.uniform(0.0, FAULT_DELAY_S))
            if run.process.poll() is not None:
                raise EndedBeforeError(run.output[-1500:])
            run.members = {SUPERVISOR: run.process.pid} | run_processes(run.process.pid)
            killed = _act(run, self.action, chance)
            return _judged(fault.name, self, at_s, run, killed)
        finally:
            run.close()


def _wait(run: TrialRun, fault: TransitionFault, processes: int) -> None:
    """Wait until the run has `processes` processes, or until the valves are safe after motion."""
    if fault.ending:
        registers = run.wait_until_moving()
        while not run.ended(registers):
            time.sleep(0.001)
        return
    deadline = time.monotonic() + START_S
    while (
        run.process.poll() is None and time.monotonic() < deadline and len(run_processes(run.process.pid)) < processes
    ):
        time.sleep(0.001)


def _act(run: TrialRun, action: TransitionAction, chance: random.Random) -> bool:
    """Act on the run; true if the supervisor, which alone reports, was killed."""
    if action is TransitionAction.VENT:
        vent = [sys.executable, "-P", "-m", "rig", "vent", "--rig", str(run.rig_file)]
        subprocess.run(vent, check=False, capture_output=True)
        return False
    if action is TransitionAction.SIGNALLED:
        for _ in range(chance.randint(1, 3)):
            run.signal((SUPERVISOR,), chance.choice(SIGNALS))
            time.sleep(chance.uniform(0.0, 0.1))
        return False
    there = [name for name in run.members if name != PLANT]
    chosen = {name: chance.choice((KILL, STOP)) for name in chance.sample(there, chance.randint(1, min(3, len(there))))}
    for name, number in chosen.items():
        run.signal((name,), number)
        time.sleep(chance.uniform(0.0, 0.03))
    stopped = tuple(name for name, number in chosen.items() if number == STOP)
    if stopped:
        time.sleep(STOPPED_S)
        run.signal(stopped, signal.SIGCONT)
    return chosen.get(SUPERVISOR) == KILL


def _judged(name: str, fault: TransitionFault, at_s: float, run: TrialRun, killed: bool) -> FaultTrial:
    wrong = []
    try:
        ended = run.process.wait(GONE_S)
    except subprocess.TimeoutExpired:
        ended, wrong = 0, ["it does not end"]
    if left := _left(run.process.pid):
        wrong.append(f"left behind: {left}")
    with contextlib.suppress(CardError):  # no card was made yet
        registers = run.attached()
        if registers is not None and not run.safe(registers):
            wrong.append(f"THE VALVES ARE NOT SAFE: {registers.outputs['value']}")
    try:
        with cards_locked(rig.config.loader.load(run.rig_file), "trial"):
            pass
    except CardError as error:
        wrong.append(str(error))
    kept, status, lost_s = archive(run.out), "no archive", 0.0
    if kept is not None:
        status = str(kept.status)
        if fault.ending and len(kept.pressure.time_s):
            lost_s = max(0.0, DURATION_S - float(kept.pressure.time_s[-1]) - 2 / kept.header.control_hz)
    elif list(run.out.glob("*")):
        wrong.append("the archive does not open, and none could be made of its journal")
    output = run.output + (kept.message if kept else "")
    found = re.search(MESSAGES, output)
    if ended == 0 and kept is not None and kept.status is not Status.FINISHED:
        wrong.append(f"exit status 0 with an archive that is {status}")
    if ended != 0 and not killed and not found and ended not in [-number for number in SIGNALS]:
        wrong.append(f"no message to the operator: nothing like '{MESSAGES}' in {output[-600:]!r}")
    if "Traceback" in output:
        wrong.append(f"a traceback: {output[-800:]}")
    if lost_s > 0.1:
        wrong.append(f"{lost_s:.2f} s of samples lost")
    message = (
        next((line.strip() for line in output.splitlines() if re.search(MESSAGES, line)), "") if not killed else ""
    )
    return FaultTrial(name, "real", at_s, status, message, math.nan, lost_s, "; ".join(wrong))


def _left(session: int) -> list[str]:
    """Processes of a run's session that are still there after what they get to follow it."""
    deadline = time.monotonic() + LEFT_S
    while (left := _members(session)) and time.monotonic() < deadline:
        time.sleep(0.02)
    return left


def _members(session: int) -> list[str]:
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, _, _, its_session = stat.read_text().rsplit(")", 1)[1].split()[:4]
            if int(its_session) == session and state != "Z":
                found.append((stat.parent / "cmdline").read_bytes().replace(b"\0", b" ").decode()[-60:])
    return found
