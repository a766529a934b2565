"""A study in the terminal: its plan, its runs in real time, and what was written."""

from __future__ import annotations

import time

from rich.console import Console

from rig.cli import run_output
from rig.cli.output import ColumnTable, print_json
from rig.cli.terminal import Terminal
from rig.execution.stop_signals import StopSignals
from rig.experiment import run as experiment
from rig.experiment.prepare import PreparedRun
from rig.study.execution import StudyResults
from rig.study.study import ASSUMED_OVERHEAD_S, Study, finished, overhead_s
from runs.catalogue import Entry
from runs.records import Status


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
        duration_s = study.prepared[index].plan.trajectory.duration_s
        table.add_row(str(index + 1), *(f"{v:.12g}" for v in settings.values()), f"{duration_s:.1f}", numbers)
    screen.print(table)
    plan, config = study.plan, study.prepared[0].config
    how = "virtual time, without rest, conditioning and prompts" if study.fast else "real time"
    screen.print(f"rig {config.name}{' (simulated)' if config.simulated else ''}, {how}")
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


def written(screen: Console, study: Study, results: StudyResults, *, as_json: bool = False) -> None:
    """Print what was written."""
    if as_json:
        runs = {number: entry.run_id for number, entry in results.runs.items()}
        files = {"page": str(results.page), "table": str(results.table)}
        print_json({"study": study.name, "planned": len(study.runs), "runs": runs, **files})
        return
    screen.print(f"{len(results.runs)} of {len(study.runs)} runs of study {study.name} are finished")
    screen.print(f"table   {results.table}", soft_wrap=True)
    screen.print(f"report  {results.page}", soft_wrap=True)


class StudyTerminal:
    """Shows each run as `rig run` does; rests and asks between the runs. Ctrl-C stops the study."""

    def __init__(self, screen: Console) -> None:
        self._screen = screen

    def run(self, prepared: PreparedRun) -> Status:
        place = prepared.study
        assert place is not None
        self._screen.print(f"study {place.study}: {place.role} {place.number}, block {place.block}", style="bold")
        with (
            StopSignals(restore=True) as signals,
            Terminal(self._screen, lambda: signals.reason, run_output.title(prepared)) as terminal,
        ):
            result = experiment.run(prepared, terminal)
        run_output.last_screen(self._screen, result)
        return result.outcome.status

    def rest(self, seconds: float) -> None:
        self._screen.print(f"rest for {seconds:g} s")
        time.sleep(seconds)

    def confirm(self, prompt: str) -> None:
        """Print what the operator has to do; return after Enter."""
        self._screen.print(prompt, style="bold yellow")
        try:
            self._screen.input("then Enter ", markup=False)
        except EOFError:
            raise KeyboardInterrupt from None
