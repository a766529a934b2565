"""Terminal output of a study."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from rich.console import Console

from rig.cli.column_table import ColumnTable
from rig.cli.json_output import print_json
from rig.study.study import ASSUMED_OVERHEAD_S, Study, finished, overhead_s
from runs.catalogue import Entry


def planned(screen: Console, study: Study, entries: tuple[Entry, ...], *, as_json: bool = False) -> None:
    """Print combinations, order and total time, from all archives of the study."""
    done = finished(entries)
    measured_s = overhead_s(study, entries)
    each_s = ASSUMED_OVERHEAD_S if measured_s is None else measured_s
    left = tuple(run for run in study.runs if run.number not in done)
    every = study.plan.settings()
    if as_json:
        runs = [
            {"number": r.number, "block": r.block, "settings": every[r.combination - 1], "done": r.number in done}
            for r in study.runs
        ]
        about = {"study": study.name, "duration_s": study.duration_s(study.runs, each_s), "runs": runs}
        overhead = {} if study.fast else {"overhead_s": each_s, "overhead_measured": measured_s is not None}
        print_json({**about, **overhead, "remaining_s": study.duration_s(left, each_s)})
        return
    screen.print(f"study {study.name}: {study.plan.title}")
    table = ColumnTable("combination", *every[0], "duration [s]", "runs, in this order")
    for index, settings in enumerate(every):
        numbers = ", ".join(str(run.number) for run in study.runs if run.combination == index + 1)
        duration_s = study.plans[index].trajectory.duration_s
        table.add_row(str(index + 1), *(f"{v:.12g}" for v in settings.values()), f"{duration_s:.1f}", numbers)
    screen.print(table)
    plan, request = study.plan, study.requests[0]
    how = "virtual time, without rest, conditioning and prompts" if study.fast else "real time"
    screen.print(f"rig {request.config.name}{' (simulated)' if request.config.simulated else ''}, {how}")
    time = "of virtual time " if study.fast else ""
    screen.print(
        f"{len(study.runs)} runs in {plan.blocks} {'block' if plan.blocks == 1 else 'blocks'}, {len(done)} done; "
        f"{_time(study.duration_s(left, each_s))} {time}remain of {_time(study.duration_s(study.runs, each_s))}"
    )
    if not study.fast:
        how = "assumed until two runs are done" if measured_s is None else "as the runs so far took"
        prompts = "; without the prompts" if plan.block_prompt else ""
        screen.print(f"with {each_s:.0f} s for the start and the end of each run ({how}){prompts}")


def _time(seconds: float) -> str:
    minutes = round(seconds / 60)
    return f"{seconds:.1f} s" if seconds < 600 else f"{minutes // 60} h {minutes % 60:02d} min"


def written(
    screen: Console, study: Study, done: Mapping[int, Entry], page: Path, table: Path, *, as_json: bool = False
) -> None:
    """Print what was written."""
    if as_json:
        runs = {number: done[number].run_id for number in sorted(done)}
        files = {"page": str(page), "table": str(table)}
        print_json({"study": study.name, "planned": len(study.runs), "runs": runs, **files})
        return
    screen.print(f"{len(done)} of {len(study.runs)} runs of study {study.name} are finished")
    screen.print(f"table   {table}", soft_wrap=True)
    screen.print(f"report  {page}", soft_wrap=True)
