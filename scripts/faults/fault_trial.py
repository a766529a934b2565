"""What a trial is, and how its archive is judged: the same for both executors."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import runs
from runs.archive.writer import ArchiveError
from runs.recovery import recover
from runs.run import Run
from scripts.faults.fault import Fault, FaultTrial

EARLIEST_S, LATEST_S = 0.2, 2.0
"""Range of the time from the first motion of the valves to the fault."""


class EndedBeforeError(Exception):
    """The run ended by itself before the fault; the message is its last output."""


@dataclass(frozen=True)
class TrialObservation:
    """What was seen from outside: monotonic or virtual times [ns]; `safe_ns` when the valves became safe for good."""

    fault_ns: int
    safe_ns: int | None
    output: str
    """The output on the terminal."""


def judge(fault: Fault, executor: str, at_s: float, watched: TrialObservation, folder: Path) -> FaultTrial:
    """Compare what came of a trial with what has to; recovers the journal where the run could not."""
    wrong = []
    run = archive(folder)
    status, output = "no archive", watched.output
    lost_s = math.nan
    if run is None:
        wrong.append("no archive, and none could be recovered")
    else:
        status = str(run.status)
        output = "\n".join((*(event.message for event in run.events), run.message, output))
        if run.status not in fault.ends:
            wrong.append(f"status {status} ({run.message})")
        lost_s = _lost_s(run, watched)
        if lost_s > 0.1:
            wrong.append(f"{lost_s:.2f} s of samples lost")
    found = re.search(fault.says, output)
    message = _sentence(output, found) if found and fault.says else ""
    if not found:
        heard = f"{run.message if run else ''} | {output[-600:]}"
        wrong.append(f"no message to the operator: nothing like '{fault.says}' in {heard!r}")
    if "Traceback" in output:
        wrong.append(f"a traceback: {output[-800:]}")
    if fault.safe and watched.safe_ns is None:
        wrong.append("THE VALVES ARE NOT SAFE")
    ended_itself = run is not None and status == "finished"
    safe_s = math.nan
    if watched.safe_ns is not None and not ended_itself:
        safe_s = (watched.safe_ns - watched.fault_ns) * 1e-9
        if safe_s > fault.within_s:
            wrong.append(f"safe only after {safe_s:.1f} s")
    return FaultTrial(fault.name, executor, at_s, status, message, safe_s, lost_s, "; ".join(wrong))


def skipped(fault: Fault, executor: str, at_s: float, why: str) -> FaultTrial:
    """A trial that this machine does not allow."""
    return FaultTrial(fault.name, executor, at_s, "", "", math.nan, math.nan, "", why)


def worst(values: Sequence[float]) -> float:
    """The largest value; not a number where there is none."""
    known = [value for value in values if not math.isnan(value)]
    return max(known) if known else math.nan


def archive(folder: Path) -> Run | None:
    """What a run has left in a folder, or what its journal is good for; None where nothing is."""
    if not list(folder.glob("*.h5")):
        recover(folder)
    for path in folder.glob("*.h5"):
        try:
            return runs.open(path)
        except ArchiveError:
            continue
    return None


def _lost_s(run: Run, watched: TrialObservation) -> float:
    """Time in which control worked, or should have, of which no sample is in the archive.

    A deadline that control missed is no lost sample: the archive counts it, and its scans are in the next row.
    """
    pressure, timing = run.pressure, run.timing
    if not len(pressure.cycle):
        return math.inf
    period_s = 1 / run.header.control_hz
    holes = np.diff(pressure.cycle) - 1 - timing.overruns[1:]
    lost_s = float(np.clip(holes, 0, None).sum()) * period_s
    last_ns = run.header.started_t_ns + round(float(pressure.time_s[-1]) * 1e9)
    until_ns = watched.fault_ns
    if str(run.status) == "aborted" and watched.safe_ns is not None:
        # From the last sample to the fault only: after it, control may have been stopped.
        until_ns = min(watched.fault_ns, watched.safe_ns)
    return lost_s + max(0.0, (until_ns - last_ns) * 1e-9 - 2 * period_s)


def _sentence(output: str, found: re.Match[str]) -> str:
    start = output.rfind("\n", 0, found.start()) + 1
    end = output.find("\n", found.end())
    return output[start : end if end >= 0 else None].strip()
