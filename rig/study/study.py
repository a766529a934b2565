"""A checked study: its plan with a prepared run of each combination, and the archives of its runs."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from statistics import median

from protocols import BadInputError, Problem, document
from protocols.library import FOLDER, find
from protocols.parameters import declared, unit_in
from protocols.problems import bad_input, closest
from protocols.source_positions import Document
from protocols.substitution import KEY
from rig.config.loader import RigChoice
from rig.experiment.options import RunOptions
from rig.experiment.prepare import PreparedRun, prepare
from rig.study.plan import PlannedRun, StudyPlan, planned_runs
from runs.archive.provenance import USER
from runs.catalogue import Entry, catalogue
from runs.records import Status, StudyRole, StudyRun
from runs.recovery import RecoveryOutcome, RecoveryStatus, orphans, recover

ASSUMED_OVERHEAD_S = 15.0
"""Until two runs of a study have shown how long the start and the end of a run take on this machine."""
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,59}")


@dataclass(frozen=True)
class Study:
    """A study that has passed every check; `prepared` are the runs of its combinations."""

    name: str
    plan: StudyPlan
    text: str
    sha256: str
    folder: Path
    runs: tuple[PlannedRun, ...]
    prepared: tuple[PreparedRun, ...]
    conditioning: PreparedRun | None

    def run(self, run: PlannedRun) -> PreparedRun:
        """A run of the study."""
        prepared = self.prepared[run.combination - 1]
        return prepared.of_study(self._place(run, StudyRole.RUN), self.plan.seed + run.number)

    def conditioning_before(self, run: PlannedRun) -> PreparedRun | None:
        """The conditioning before a run; None without any."""
        if self.conditioning is None:
            return None
        return self.conditioning.of_study(self._place(run, StudyRole.CONDITIONING), self.conditioning.plan.seed)

    @property
    def fast(self) -> bool:
        """Whether the study runs in virtual time, in which a simulated arm begins each run as new."""
        return self.prepared[0].options.fast

    def duration_s(self, runs: tuple[PlannedRun, ...], overhead_s: float) -> float:
        """Time of these runs [s], with rests, conditioning and the overhead of each run; without prompts."""
        total = sum(self.prepared[run.combination - 1].plan.trajectory.duration_s for run in runs)
        if self.fast:
            return total
        cycles = 0
        if self.conditioning is not None:
            cycles = len(runs) if self.plan.conditioning_each_run else len({run.block for run in runs})
            total += cycles * self.conditioning.plan.trajectory.duration_s
        return total + (len(runs) + cycles) * overhead_s + self.plan.rest_s * max(len(runs) - 1, 0)

    def _place(self, run: PlannedRun, role: StudyRole) -> StudyRun:
        return StudyRun(self.name, role, run.number, run.combination, run.block, self.text, self.sha256)


def load(file: Path, rig: RigChoice, options: RunOptions) -> Study:
    """Read a plan, and check every combination of its parameters against protocol and rig.

    `options` are those of every run; the plan has its settings and seeds.

    Raises:
        BadInputError: every problem of plan, protocols and rig.
    """
    source = document.read(file)
    plan = document.validate(StudyPlan, source)
    if not NAME.fullmatch(file.stem):
        expected = "a file whose name, the name of the study, has letters, digits, _ and - only, at most 60"
        raise bad_input(str(file), file.stem, expected)
    protocol = _protocol(source, plan.protocol, ("protocol",))
    if problems := list(_setting_problems(source, plan, protocol)):
        raise BadInputError(problems)
    checked = _checked_runs(source, plan, protocol, rig, replace(options, report=False))
    return Study(
        name=file.stem,
        plan=plan,
        text=source.text,
        sha256=_digest(plan, checked),
        folder=Path(options.out),
        runs=planned_runs(plan),
        prepared=tuple(checked[: len(plan.settings())]),
        conditioning=checked[-1] if plan.conditioning is not None else None,
    )


def _checked_runs(
    source: Document, plan: StudyPlan, protocol: Path, rig: RigChoice, options: RunOptions
) -> list[PreparedRun]:
    """The run of every combination, and then the conditioning, if there is one.

    Raises:
        BadInputError: every problem, with the combinations that have it.
    """
    every = plan.settings()
    wanted: list[tuple[Path, Mapping[str, float], str]] = []
    for number, settings in enumerate(every, 1):
        values = ", ".join(f"{name} = {value:.12g}" for name, value in settings.items())
        wanted.append((protocol, settings, f"combination {number} ({values})" if values else "the protocol"))
    if plan.conditioning is not None:
        path = _protocol(source, plan.conditioning.protocol, ("conditioning", "protocol"))
        wanted.append((path, plan.conditioning.settings, "conditioning"))
    checked: list[PreparedRun] = []
    found: dict[Problem, list[str]] = {}
    for name, chosen, what in wanted:
        try:
            checked.append(prepare(name, rig, replace(options, settings=chosen)))
        except BadInputError as bad:
            for problem in bad.problems:
                found.setdefault(problem, []).append(what)
    if found:
        raise BadInputError(_named(problem, where, len(every)) for problem, where in found.items())
    return checked


def _named(problem: Problem, where: list[str], combinations: int) -> Problem:
    """The problem with the first combination that has it, unless every combination has it."""
    if len(set(where)) >= combinations > 1:
        return problem
    return replace(problem, where=": ".join(part for part in (where[0], problem.where) if part))


def _protocol(source: Document, name: str, path: tuple[str, ...]) -> Path:
    """The file of a protocol that the plan names: beside the plan, else by its name."""
    if (beside := Path(source.file).parent / name).is_file():
        return beside
    try:
        return find(name, FOLDER, "protocol")
    except BadInputError as bad:
        found = [source.problem(path, p.expected, suggestion=p.suggestion) for p in bad.problems]
        raise BadInputError(found) from None


def _setting_problems(source: Document, plan: StudyPlan, protocol: Path) -> Iterator[Problem]:
    """Problems of names and values that the protocol does not have, each at its place in the plan."""
    known = declared(document.read(protocol).data.get(KEY))
    values: list[tuple[tuple[str | int, ...], str, float]] = []
    for name, levels in plan.factors.items():
        values += [(("factors", name, index), name, level) for index, level in enumerate(levels)]
    for index, settings in enumerate(plan.combinations):
        values += [(("combinations", index, name), name, value) for name, value in settings.items()]
    unknown: set[str] = set()
    for path, name, value in values:
        parameter = known.get(name)
        if name not in known and name not in unknown:
            unknown.add(name)
            expected = f"a parameter of {protocol.stem}: {', '.join(known) or 'it has none'}"
            yield source.problem(path[: path.index(name) + 1], expected, name, closest(name, known), at_key=True)
        elif parameter is not None and not parameter.admits(value):
            expected = parameter.expected(unit_in(name, parameter))
            yield source.problem(path, expected)


def _digest(plan: StudyPlan, checked: list[PreparedRun]) -> str:
    """SHA-256 of everything that defines the runs; comments and layout of the files do not."""
    parts: list[object] = [plan.model_dump(mode="json")]
    for one in checked:
        protocol = document.parse(one.protocol.text, one.protocol.name).data
        parts += [protocol, sorted(one.protocol.files.items()), dict(one.rig.data), one.plan.variant]
        parts += [one.options.fast, sorted(specimen_facts(one.metadata).items())]
    return hashlib.sha256(json.dumps(parts, default=str).encode()).hexdigest()


class OtherStudyError(Exception):
    """The folder has runs of a study of this name under other conditions: plan, protocol, rig, specimen or time."""


def archived(study: Study) -> tuple[Entry, ...]:
    """The archives of a study in its folder, newest first, its conditioning included.

    Journals of runs that were cut off are recovered first: a run that was complete then counts as finished.

    Raises:
        OtherStudyError: archives of the same name were made under other conditions.
    """
    recovered(study.folder)
    entries = tuple(entry for entry in catalogue(study.folder) if entry.study == study.name)
    if others := sorted(entry.file for entry in entries if entry.study_sha256 != study.sha256):
        raise OtherStudyError(
            f"{study.folder / others[0]}: this run of study {study.name} was made under other conditions: another "
            "plan, protocol, rig, specimen, kind of time or version of softrig. Restore them (`rig export --format "
            "yaml` writes the inputs of this run), or begin another study: copy the plan to a new name"
        )
    return entries


def recovered(folder: Path) -> tuple[str, ...]:
    """Make archives of the journals of runs that were cut off; return a sentence about each journal."""
    return tuple(filter(None, map(_said, recover(folder)))) if orphans(folder) else ()


def _said(outcome: RecoveryOutcome) -> str:
    if outcome.status in (RecoveryStatus.RECOVERED, RecoveryStatus.FINALISED):
        return f"a run was cut off: its journal is {outcome.status} as {outcome.archive} ({outcome.message})"
    if outcome.status is RecoveryStatus.UNREADABLE:
        return f"a run was cut off: its journal {outcome.path} is kept, but cannot be read: {outcome.message}"
    return ""


def overhead_s(study: Study, entries: Iterable[Entry]) -> float | None:
    """Time that a run of this study takes beyond its protocol [s]: processes start, and the archive is made.

    The median over its archived runs; None with fewer than two, and in virtual time.
    """
    runs = sorted(
        ((datetime.fromisoformat(entry.start_time), entry) for entry in entries if not study.fast),
        key=lambda run: run[0],
    )
    gaps = [
        (after - before).total_seconds()
        - entry.duration_s
        - (study.plan.rest_s if entry.study_role == StudyRole.RUN else 0.0)
        for (before, entry), (after, _) in pairwise(runs)
    ]
    return max(median(gaps), 0.0) if gaps else None


def finished(entries: tuple[Entry, ...]) -> dict[int, Entry]:
    """The finished runs by number."""
    return {
        entry.study_number: entry
        for entry in entries
        if entry.study_number and entry.study_role == StudyRole.RUN and entry.status == Status.FINISHED
    }


def specimen_facts(metadata: Mapping[str, str]) -> dict[str, str]:
    """The metadata about the specimen, without those about the operator: another operator may continue a study."""
    return {name: text for name, text in metadata.items() if name not in USER}
