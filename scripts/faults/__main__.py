"""`python -m scripts.faults`: run the campaign, print what came of each fault, write the table."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from scripts.faults import table
from scripts.faults.campaign import EXECUTORS, jobs, tried
from scripts.faults.catalogue import CATALOGUE
from scripts.faults.fault import FaultTrial


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the requested trials; 0 if every result is as expected."""
    parser = argparse.ArgumentParser(prog="python -m scripts.faults", description=__doc__)
    parser.add_argument("--trials", type=int, default=10, help="random moments per fault and executor")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--executor", choices=(*EXECUTORS, "both"), default="both")
    parser.add_argument("--only", default="", help="faults whose name contains this")
    parser.add_argument("--beside", type=int, default=os.cpu_count() or 1, help="runs in real time side by side")
    parser.add_argument("--write", type=Path, help="Markdown file whose table is replaced")
    parser.add_argument("--log", type=Path, help="file of trials to add to; what is in it already is not tried again")
    parser.add_argument("--list", action="store_true", help="name the faults and do nothing")
    options = parser.parse_args(arguments)
    try:
        faults = CATALOGUE.named_like(options.only)
    except KeyError as error:
        parser.error(error.args[0])
    if options.list:
        print("\n".join(f"{fault.kind:14}{fault.name}" for fault in faults))
        return 0
    executors = EXECUTORS if options.executor == "both" else (options.executor,)
    trials = _logged(options.log)
    known = {(trial.fault, trial.executor, trial.at_s) for trial in trials}
    due = [job for job in jobs(faults, executors, options.trials, options.seed) if job.key not in known]
    for number, made in enumerate(tried(due, options.beside), 1):
        trials.append(made)
        print(f"{number}/{len(due)} {line(made)}", flush=True)
        if options.log:
            with options.log.open("a") as log:
                log.write(json.dumps(asdict(made)) + "\n")
    if options.write:
        table.write(options.write, faults, trials)
    bad = [trial for trial in trials if trial.wrong]
    print(f"{len(trials)} trials of {len({t.fault for t in trials})} faults, {len(bad)} not as they must be")
    for trial in bad:
        print(f"  {line(trial)}")
    return 1 if bad else 0


def _logged(log: Path | None) -> list[FaultTrial]:
    if log is None or not log.exists():
        return []
    return [FaultTrial(**json.loads(text)) for text in log.read_text().splitlines()]


def line(trial: FaultTrial) -> str:
    """One trial in one line."""
    head = f"{trial.executor:8}{trial.fault}, {trial.at_s:.2f} s"
    if trial.skipped:
        return f"{head}: not tried: {trial.skipped}"
    body = f"{trial.status}, safe after {trial.safe_s * 1e3:.0f} ms, {trial.lost_s * 1e3:.0f} ms lost: {trial.message}"
    return f"{head}: {body}{'  WRONG: ' + trial.wrong if trial.wrong else ''}"


if __name__ == "__main__":
    sys.exit(main())
