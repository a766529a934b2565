"""`rig study`: the runs of a plan, its table and its page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rig.cli.exit_status import FAULT
from rig.cli.options import AsJson, RigName, Scheduler
from rig.cli.run_options import takes_run_options
from rig.experiment.options import RunOptions

PlanFile = Annotated[Path, typer.Argument(metavar="PLAN", help="YAML file of the study.", dir_okay=False)]


@takes_run_options("fast", "out", "operator", "meta", "yes")
def study(
    plan: PlanFile,
    *,
    rig: RigName = None,
    options: RunOptions,
    dry: Annotated[bool, typer.Option("--dry", help="Check and print the plan only; nothing moves.")] = False,
    scheduler: Scheduler = None,
    json: AsJson = False,
) -> None:
    """Run a study, or what is missing of it; write its table and its page.

    After any interruption, repeat the command: finished runs are not repeated.
    """
    from protocols.problems import bad_input
    from rig.cli import study_output
    from rig.cli.output import console
    from rig.cli.progress import progress_bar
    from rig.cli.run_output import confirm
    from rig.config.loader import chosen_rig
    from rig.study import execution
    from rig.study.study import archived, finished, load, recovered

    if scheduler and not options.fast:
        raise bad_input("--scheduler", scheduler, "--fast: only runs in virtual time are spread over a cluster")
    found = load(plan, chosen_rig(rig), options)
    screen = console(stderr=json)

    def tell_recovered() -> None:
        for sentence in recovered(found.folder):
            typer.echo(sentence, err=True)

    if dry:
        tell_recovered()
        study_output.planned(screen, found, archived(found), as_json=json)
        return
    with execution.locked(found) as scratch:
        tell_recovered()
        done = finished(archived(found))
        if len(done) < len(found.runs):
            study_output.planned(screen, found, archived(found))
            if not options.yes and not confirm(screen):
                raise bad_input("--yes", "", "a confirmation: the study is not armed")
        try:
            if len(done) < len(found.runs) and found.fast:
                with progress_bar("runs") as progress:
                    execution.run_virtual(found, scratch, scheduler=scheduler, progress=progress)
            elif len(done) < len(found.runs):
                execution.run_real(found, study_output.StudyTerminal(screen))
        finally:
            if results := execution.write_results(found):
                study_output.written(screen, found, results, as_json=json)
        missing = len(found.runs) - len(results.runs if results else ())
        if missing:
            screen.print(f"repeat the command for the {missing} runs that are missing")
            raise typer.Exit(FAULT)
