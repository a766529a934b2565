"""`python -m scripts.faults`: run the campaign, print what came of each fault, write the table."""

from __future__ import annotations

import argparse
import json
import math
import random
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from scripts.faults import realtime, table, virtual
from scripts.faults.catalogue import CATALOGUE, Fault
from scripts.faults.trial import EARLIEST_S, LATEST_S, Trial


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is asked for; 0 when every trial came out as it must."""
    parser = argparse.ArgumentParser(prog="python -m scripts.faults", description=__doc__)
    parser.add_argument("--trials", type=int, default=10, help="random moments per fault and executor")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--executor", choices=("real", "virtual", "both"), default="both")
    parser.add_argument("--only", default="", help="faults whose name contains this")
    parser.add_argument("--write", type=Path, help="Markdown file whose table is replaced")
    parser.add_argument("--log", type=Path, help="file of trials to add to: the table is made of all in it")
    parser.add_argument("--list", action="store_true", help="name the faults and do nothing")
    options = parser.parse_args(arguments)
    faults = [fault for fault in CATALOGUE if options.only in fault.name]
    if options.list:
        print("\n".join(f"{fault.kind:14}{fault.name}" for fault in faults))
        return 0
    chance = random.Random(options.seed)
    jobs = [
        (fault, executor, chance.uniform(EARLIEST_S, LATEST_S), chance.randrange(2**31))
        for _ in range(options.trials)
        for fault in faults
        for executor in ("virtual", "real")
        if getattr(fault, executor) and options.executor in (executor, "both")
    ]
    chance.shuffle(jobs)
    trials = []
    for number, job in enumerate(jobs, 1):
        trials.append(_try(*job))
        print(f"{number}/{len(jobs)} {line(trials[-1])}", flush=True)
        if options.log:
            with options.log.open("a") as log:
                log.write(json.dumps(asdict(trials[-1])) + "\n")
    if options.log and options.log.exists():
        trials = [Trial(**json.loads(text)) for text in options.log.read_text().splitlines()]
    if options.write:
        table.write(options.write, faults, trials)
    bad = [trial for trial in trials if trial.wrong]
    print(f"{len(trials)} trials of {len(faults)} faults, {len(bad)} not as they must be")
    for trial in bad:
        print(f"  {line(trial)}")
    return 1 if bad else 0


def _try(fault: Fault, executor: str, at_s: float, seed: int) -> Trial:
    with tempfile.TemporaryDirectory(prefix="softrig-faults-") as folder:
        try:
            if executor == "virtual":
                return virtual.trial(fault, Path(folder), at_s, seed)
            return realtime.trial(fault, Path(folder), at_s)
        except Exception as error:
            wrong = f"{type(error).__name__}: {error}"
            return Trial(fault.name, executor, at_s, "no trial", "", math.nan, math.nan, wrong)


def line(trial: Trial) -> str:
    """One trial in one line."""
    head = f"{trial.executor:8}{trial.fault}, {trial.at_s:.2f} s"
    if trial.skipped:
        return f"{head}: not tried: {trial.skipped}"
    body = f"{trial.status}, safe after {trial.safe_s * 1e3:.0f} ms, {trial.lost_s * 1e3:.0f} ms lost: {trial.told}"
    return f"{head}: {body}{'  WRONG: ' + trial.wrong if trial.wrong else ''}"


if __name__ == "__main__":
    sys.exit(main())
