"""The trials of a campaign, and how they are made: side by side, each in a process of its own."""

from __future__ import annotations

import math
import multiprocessing
import os
import random
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from scripts.faults import realtime, virtual
from scripts.faults.fault import Fault, FaultTrial
from scripts.faults.fault_trial import EARLIEST_S, LATEST_S, EndedBeforeError

EXECUTORS = ("real", "virtual")
ATTEMPTS = 3


@dataclass(frozen=True)
class Job:
    """One trial to be made; a part of a campaign has the same jobs as the whole."""

    fault: Fault
    executor: str
    at_s: float
    seed: int

    @property
    def key(self) -> tuple[str, str, float]:
        """Identifies the job, and its trial in a log."""
        return self.fault.name, self.executor, self.at_s


def jobs(faults: Sequence[Fault], executors: Sequence[str], moments: int, seed: int) -> Iterator[Job]:
    """Every fault once, in any order, then every fault again: an interrupted campaign has tried all equally often."""
    for moment in range(moments):
        turn = [(fault, executor) for fault in faults for executor in executors if getattr(fault, executor)]
        random.Random(f"{seed} {moment}").shuffle(turn)
        for fault, executor in turn:
            chance = random.Random(f"{seed} {moment} {fault.name} {executor}")
            yield Job(fault, executor, chance.uniform(EARLIEST_S, LATEST_S), chance.randrange(2**31))


def tried(due: Sequence[Job], beside: int) -> Iterator[FaultTrial]:
    """Make the trials, each as it comes: real time side by side, virtual time in what the machine has left."""
    spawn = multiprocessing.get_context("spawn")
    with ExitStack() as stack:
        pools = {
            "real": stack.enter_context(ProcessPoolExecutor(beside, spawn)),
            "virtual": stack.enter_context(ProcessPoolExecutor(1, spawn, os.nice, (10,))),
        }
        made: list[Future[FaultTrial]] = [pools[job.executor].submit(_try, job) for job in due]
        try:
            for future in as_completed(made):
                yield future.result()
        finally:
            for future in made:
                future.cancel()


def _try(job: Job) -> FaultTrial:
    trial = virtual.trial if job.executor == "virtual" else realtime.trial
    early = ""
    for _ in range(ATTEMPTS):
        with tempfile.TemporaryDirectory(prefix="softrig-faults-") as folder:
            try:
                return trial(job.fault, Path(folder), job.at_s, job.seed)
            except EndedBeforeError as error:
                early = f"{ATTEMPTS} runs ended before the fault: {error}"
            except Exception as error:
                early = f"{type(error).__name__}: {error}"
                break
    return FaultTrial(job.fault.name, job.executor, job.at_s, "no trial", "", math.nan, math.nan, early)
