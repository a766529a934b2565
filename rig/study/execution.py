"""Runs the remaining runs of a study: one after the other in real time, over all cores in virtual time.

A run counts when its archive is in the study's folder and says that it finished. Only the process that holds the lock
of the study puts archives there, each by one rename, so an interruption at any moment neither loses nor doubles a run.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, Protocol

from calibration.parallel_map import parallel_results
from rig.execution.plan import NullOperator, StartError
from rig.experiment import run as experiment
from rig.experiment.prepare import PreparedRun
from rig.study.plan import StopRules
from rig.study.study import Study, archived, finished
from runs.catalogue import Entry
from runs.data_folder import free_id
from runs.journal.append_only_file import lock
from runs.overwriting import naming
from runs.records import Status, StudyRole
from runs.recovery import move_unused
from runs.study.page import write


class StudyBusyError(StartError):
    """Another process runs this study."""


class StudyStoppedError(Exception):
    """A rule of the plan stopped the study."""


class StudyOperator(Protocol):
    """The operator's side of a study in real time. Each method raises `KeyboardInterrupt` when the operator stops."""

    def run(self, prepared: PreparedRun) -> Status:
        """Perform a run; return how it ended."""

    def rest(self, seconds: float) -> None:
        """Wait."""

    def confirm(self, prompt: str) -> None:
        """Show what the operator has to do; return when it is done."""


@contextmanager
def locked(study: Study) -> Iterator[Path]:
    """Hold the lock of a study; yield a folder for files that are being written.

    Journals and archives that an interrupted study left there come into the study's folder first.

    Raises:
        StudyBusyError: another process holds it.
    """
    scratch = study.folder / f".{study.name}.study"
    scratch.mkdir(parents=True, exist_ok=True)
    with (scratch / "lock").open("a") as handle:
        try:
            lock(handle.fileno())
        except BlockingIOError:
            raise StudyBusyError(f"study {study.name} in {study.folder} is running in another process") from None
        for left in scratch.iterdir():
            if left.is_dir():
                move_unused(left, study.folder)
        yield scratch


class StudyResults(NamedTuple):
    """The finished runs of a study by number, in their order, and the page and the table of them."""

    runs: dict[int, Entry]
    page: Path
    table: Path


def write_results(study: Study) -> StudyResults | None:
    """Write page and table of the runs that are finished; None without any."""
    runs = dict(sorted(finished(archived(study)).items()))
    if not runs:
        return None
    files = [study.folder / entry.file for entry in runs.values()]
    return StudyResults(runs, *write(study.name, study.plan.title, len(study.runs), files, study.folder))


def run_virtual(
    study: Study,
    scratch: Path,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Run what is missing in virtual time, over the cores of this machine or a Dask cluster.

    Rest, conditioning and prompts are left out: a simulated arm begins each run as new. `workers` and `scheduler` are
    those of `parallel_map`; workers of a cluster need softrig, but no common folder.

    Raises:
        StudyStoppedError: a rule of the plan stopped the study.
        WorkerDiedError, NoClusterError: as `parallel_map`.
    """
    done = finished(archived(study))
    tasks = [_Task(study.run(run), None if scheduler else scratch) for run in study.runs if run.number not in done]
    rules = _RuleCheck(study)
    progress(len(done), len(study.runs))
    with closing(parallel_results(_archive_of, tasks, range(len(tasks)), workers, scheduler)) as results:
        for count, (_, made) in enumerate(results, len(done) + 1):
            part = scratch / made.name
            # Runs in folders of their own that start in one second have one name, for example after an interruption.
            archive = study.folder / f"{free_id(study.folder, part.stem)}{part.suffix}"
            with naming(archive, part):
                part.write_bytes(made.content)
                part.replace(archive)
            progress(count, len(study.runs))
            rules.check()


@dataclass(frozen=True)
class _Task:
    prepared: PreparedRun
    scratch: Path | None
    """Where the worker writes; None for its own temporary folder."""


@dataclass(frozen=True)
class _ArchiveFile:
    name: str
    content: bytes


def _archive_of(task: _Task) -> _ArchiveFile:
    """Run a task in a folder of its own; return its archive.

    The folder is removed only after that: until then it may have the only copy of the data.
    """
    folder = Path(tempfile.mkdtemp(dir=task.scratch))
    prepared = replace(task.prepared, options=replace(task.prepared.options, out=folder))
    result = experiment.run(prepared, NullOperator())
    if result.archive is None:
        raise StartError("; ".join(result.warnings))
    made = _ArchiveFile(result.archive.name, result.archive.read_bytes())
    shutil.rmtree(folder)
    return made


def run_real(study: Study, operator: StudyOperator) -> None:
    """Run what is missing, one run after the other, with rest, conditioning and prompts.

    Raises:
        StudyStoppedError: a rule of the plan stopped the study.
        KeyboardInterrupt: the operator stopped a run or the study.
    """
    entries = archived(study)
    done, begun = finished(entries), {entry.study_block for entry in entries}
    conditioned: int | None = None
    rules, first = _RuleCheck(study), True
    for run in study.runs:
        if run.number in done:
            continue
        if not first and study.plan.rest_s:
            operator.rest(study.plan.rest_s)
        first = False
        if study.plan.block_prompt and run.block not in begun:
            operator.confirm(f"block {run.block} of {study.plan.blocks}: {study.plan.block_prompt}")
        begun.add(run.block)
        before = study.conditioning_before(run)
        if before is not None and (study.plan.conditioning_each_run or conditioned != run.block):
            _performed(operator, before)
            rules.check()
        conditioned = run.block
        _performed(operator, study.run(run))
        rules.check()


def _performed(operator: StudyOperator, prepared: PreparedRun) -> None:
    if operator.run(prepared) is Status.INTERRUPTED:
        raise KeyboardInterrupt


class _RuleCheck:
    """Applies the stop rules: when it is made, and to the archives that are new since then."""

    def __init__(self, study: Study) -> None:
        self._study = study
        self._before = {entry.file for entry in archived(study)}
        self.check()

    def check(self) -> None:
        new = [entry for entry in archived(self._study) if entry.file not in self._before]
        if reason := stop_reason(self._study.plan.stop, new):
            raise StudyStoppedError(f"study {self._study.name} is stopped by its plan: {reason}")


def stop_reason(rules: StopRules, new: Sequence[Entry]) -> str:
    """Return why a study ends now, by its archives since it was last begun, newest first; empty to go on.

    In virtual time runs end in another order than they begin, so that each new one is judged.
    """
    failed = 0
    for entry in new:
        if entry.status == Status.FINISHED:
            break
        failed += 1
    if failed >= rules.failed_runs:
        count = "a run" if failed == 1 else f"{failed} runs in succession"
        last = f"{new[0].run_id} ({new[0].status})"
        return f"{count} did not finish, the last {last}; stop.failed_runs is {rules.failed_runs}"
    if rules.mean_error_mm is not None:
        for entry in new:
            error_mm = entry.mean_error_mm
            if entry.study_role == StudyRole.RUN and error_mm is not None and error_mm > rules.mean_error_mm:
                found = f"run {entry.run_id} has a mean error of {error_mm:.3g} mm between measured and modelled tip"
                return f"{found}; stop.mean_error_mm is {rules.mean_error_mm:g}"
    return ""
