"""Studies from Python: the operator is a function, as for the prompts of a run."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from pathlib import Path

from rig.execution.plan import RunPlan
from rig.experiment.run import RunRequest, RunResult
from rig.session.prompts import Answer
from rig.study import execution
from rig.study.study import Study, archived, finished, recovered
from runs.records import Status
from runs.run import Run
from runs.study.page import write


class FunctionStudyOperator:
    """Performs runs by `perform`, rests by sleeping, and passes each prompt to `answer`."""

    def __init__(self, perform: Callable[[RunRequest, RunPlan], RunResult], answer: Answer | None) -> None:
        self._perform = perform
        self._answer = answer

    def run(self, request: RunRequest, plan: RunPlan) -> Status:
        """Perform a run; return how it ended."""
        return self._perform(request, plan).outcome.status

    def rest(self, seconds: float) -> None:
        """Wait."""
        time.sleep(seconds)

    def confirm(self, prompt: str) -> None:
        """Return when the function has returned."""
        if self._answer is not None:
            self._answer(prompt)


def run_study(
    study: Study, operator: FunctionStudyOperator, workers: int | None = None, scheduler: str | None = None
) -> tuple[Run, ...]:
    """Run what is missing of a study, write its table and page, and return its finished runs in their order."""
    with execution.locked(study) as scratch:
        for sentence in recovered(study.folder):
            warnings.warn(sentence, stacklevel=3)
        try:
            if study.fast:
                execution.run_virtual(study, scratch, workers, scheduler)
            else:
                execution.run_real(study, operator)
        finally:
            done = finished(archived(study))
            files: list[Path] = [study.folder / done[number].file for number in sorted(done)]
            if files:
                write(study.name, study.plan.title, len(study.runs), files, study.folder)
    return tuple(Run(file) for file in files)
