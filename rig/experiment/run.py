"""One run, start to finish: check, lock, arm, run, make safe, finalise."""

from __future__ import annotations

import platform
import resource
import shlex
import shutil
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, get_args

import protocols
from protocols import BadInputError, Problem, Protocol, Trajectory
from protocols.problems import closest
from rig.config.loader import RigChoice, Source, parse, path_of, read
from rig.config.schema import RigConfig, Variant
from rig.execution.plan import OperatorInterface, Outcome, Plan, StartError
from rig.experiment import report_process
from rig.experiment.preflight import check
from rig.experiment.provenance import git_state, quantities, versions
from rig.hardware.cards.base import CardError
from rig.hardware.lock import cards_locked
from rig.realtime.scheduling import obtainable
from rig.realtime.timing_limits import timing_limits
from runs.journal.append_only_file import JournalError
from runs.records import Event, Interval, Level, Quantity, RunFooter, RunHeader, SourceFile, Status

if TYPE_CHECKING:
    from runs.journal.journal import JournalWriter

VARIANTS: tuple[Variant, ...] = get_args(Variant)
Loaded = TypeVar("Loaded")
Name = TypeVar("Name")
SPARE_DISK_BYTES = 200_000_000
ADDRESS_SPACE_BYTES = 1_200_000_000
"""What the largest process of a run maps, with its libraries; most of it is never touched."""
TOLD_AFTER_S = 2.0
"""What a disk gets to take the end of the record before the operator is told that he waits for it."""
_EXPECTED = (CardError, StartError, JournalError)


@dataclass(frozen=True)
class RunRequest:
    """What the operator asked for."""

    protocol: Protocol
    config: RigConfig
    rig_file: Path
    rig_text: str
    fast: bool
    seed: int
    folder: Path
    variant: Variant
    operator: str = ""
    notes: str = ""
    report: bool = True
    adapted: tuple[Quantity, ...] = ()
    sources: tuple[SourceFile, ...] = ()
    parameters_text: str = ""
    """The file of identified parameters that lies over the rig, verbatim; `rig_text` has them in it."""
    rig_source: Source = Source.OPTION


@dataclass(frozen=True)
class RunResult:
    """What a run left behind; `archive` is None when it never began, `report` when none was made."""

    outcome: Outcome
    archive: Path | None
    report: Path | None
    parameters: Path | None = None
    """What the recursive estimator found, where one ran."""
    trouble: tuple[str, ...] = ()
    """What went wrong after the run itself: the archive or the report could not be written."""


def request(
    protocol: str,
    rig: str | RigChoice,
    *,
    folder: Path = Path("data"),
    fast: bool = False,
    seed: int = 0,
    variant: str | None = None,
    operator: str = "",
    notes: str = "",
    report: bool = True,
    parameters: Path | None = None,
    adapt: Sequence[str] | None = None,
) -> RunRequest:
    """Load a protocol and a rig by name or file, with a file of identified `parameters` over the rig.

    `adapt` names the parameters that a recursive estimator finds beside the run: the usual ones where it is empty,
    none where it is None.

    Raises:
        UnknownParameter, NotAdaptable: of those names, one stands for no parameter or cannot be found that way.
        BadInput: any of them is wrong; every problem at once.
    """
    source = rig.source if isinstance(rig, RigChoice) else Source.OPTION
    rig = rig.name if isinstance(rig, RigChoice) else rig
    problems: list[Problem] = []
    asked = _collecting(problems, protocols.load, protocol)
    rig_read = _collecting(problems, read, rig)
    chosen = _collecting(problems, variant_named, variant)
    if problems or asked is None or rig_read is None:
        raise BadInputError(problems)
    config, rig_text, parameters_text = rig_read.config, rig_read.text, ""
    if parameters is not None:
        from rig.config.parameters_overlay import over

        rig_text, parameters_text = over(rig_text, path_of(rig), parameters, chosen)
        config = parse(rig_text, f"{path_of(rig)} with {parameters}")
    adapted: tuple[Quantity, ...] = ()
    if adapt is not None:
        from rig.observation.online_estimation import adapted as estimated
        from rig.observation.online_estimation import usual

        variant_used = chosen or config.model.variant
        adapted = estimated(config, variant_used, adapt or usual(variant_used))
    return RunRequest(
        protocol=asked,
        config=config,
        rig_file=path_of(rig),
        rig_text=rig_text,
        fast=fast,
        seed=seed,
        folder=folder,
        variant=chosen or config.model.variant,
        operator=operator,
        notes=notes,
        report=report,
        adapted=adapted,
        sources=rig_read.sources,
        parameters_text=parameters_text,
        rig_source=source,
    )


def variant_named(name: str | None) -> Variant | None:
    """The model variant of that name, None for none; `BadInput` where there is no such variant."""
    chosen = next((known for known in VARIANTS if known == name), None)
    if name is not None and chosen is None:
        expected = f"one of {', '.join(VARIANTS)}"
        raise BadInputError([Problem("--model", 0, 0, "", name, expected, closest(name, VARIANTS))])
    return chosen


def _collecting(problems: list[Problem], read: Callable[[Name], Loaded], name: Name) -> Loaded | None:
    try:
        return read(name)
    except BadInputError as bad:
        problems.extend(bad.problems)
        return None


def plan(request: RunRequest) -> Plan:
    """Expand and check a request without touching any device.

    Raises:
        BadInput: a limit is violated, or the rig cannot run the protocol; every problem at once.
    """
    trajectory = request.protocol.expand(request.config.actuators)
    if problems := check(request.config, trajectory, request.protocol, request.rig_file):
        raise BadInputError(problems)
    return Plan(request.config, request.rig_file, trajectory, request.variant, request.seed, request.adapted)


def run(request: RunRequest, decided: Plan, audience: OperatorInterface) -> RunResult:
    """Run a plan and leave an archive, however the run ends.

    Raises:
        CardError, StartError, JournalError: the run could not begin; the valves are safe and there is no archive.
    """
    address_space = resource.getrlimit(resource.RLIMIT_AS)[0]
    if address_space != resource.RLIM_INFINITY and address_space < ADDRESS_SPACE_BYTES:
        raise StartError(
            f"the address space of a process is limited to {address_space / 1e6:.0f} MB (ulimit -v), "
            f"a run wants {ADDRESS_SPACE_BYTES / 1e6:.0f} MB"
        )
    # In real time nothing is loaded beside the control loop.
    with report_process.waiting() if request.fast and request.report else nullcontext(report_process.here) as draw:
        return _run(request, decided, audience, draw)


def _run(request: RunRequest, decided: Plan, audience: OperatorInterface, draw: Callable[[Path], Path]) -> RunResult:
    if request.fast:
        from rig.virtual.executor import run as execute
    else:
        from rig.realtime.supervisor import run as execute
    # HDF5 and MCAP are for runs alone: `rig check` imports neither.
    from runs.archive.writer import ArchiveError, finalise
    from runs.journal.journal import JournalWriter

    request.folder.mkdir(parents=True, exist_ok=True)
    if (free := shutil.disk_usage(request.folder).free) < SPARE_DISK_BYTES:
        raise StartError(
            f"{request.folder}: only {free / 1e6:.0f} MB free, a run wants {SPARE_DISK_BYTES / 1e6:.0f} MB"
        )
    journal: JournalWriter | None = None
    patience_s = timing_limits(decided.config, obtainable()).disk_s

    def armed(t_ns: int) -> JournalWriter:
        nonlocal journal
        # The first tick is yet to come; virtual time has no place in the calendar but its beginning.
        ahead_ns = 0 if request.fast else t_ns - time.monotonic_ns()
        about = header(request, decided, t_ns, ahead_ns)
        journal = JournalWriter(
            request.folder / f"{about.run_id}.mcap", about, live=not request.fast, patience_s=patience_s
        )
        if request.rig_source in (Source.ENVIRONMENT, Source.FOLDER):
            # The command, which the record has, does not tell.
            said = f"the rig is {request.rig_file.absolute()}, chosen by {request.rig_source}"
            journal.event(Event(t_ns, Level.INFO, "conductor", said))
        return journal

    trouble: list[str] = []
    with nullcontext() if request.fast else cards_locked(decided.config, f"protocol {request.protocol.name}"):
        try:
            outcome = execute(decided, armed, audience)
        except Exception as error:
            if journal is None:
                raise
            # Virtual time is known by what was recorded last.
            ended_ns = journal.newest_t_ns if request.fast else time.monotonic_ns()
            outcome = Outcome(Status.ABORTED, _told(error), ended_ns)
            with suppress(JournalError):
                if not isinstance(error, _EXPECTED):
                    journal.event(Event(ended_ns, Level.FAULT, "conductor", traceback.format_exc()))
    assert journal is not None
    archive = report = parameters = None
    try:
        if not journal.wait_until_synced(TOLD_AFTER_S):
            waiting = f"waiting for the disk to take the rest of {journal.path}"
            audience.tell(Event(time.monotonic_ns(), Level.WARNING, "conductor", waiting))
        journal.close(RunFooter(outcome.t_ns, outcome.status, outcome.message, outcome.counters))
        archive = finalise(journal.path)
    except (ArchiveError, JournalError) as error:
        trouble.append(f"{error}; the journal is kept: {journal.path}; run `rig recover {request.folder}` later")
    if archive is not None and request.report:
        try:
            report = draw(archive)
        except OSError as error:
            trouble.append(f"no report: {error}; run `rig report {archive}` later")
    if archive is not None and decided.adapted:
        try:
            parameters = _parameters(archive)
        except OSError as error:
            trouble.append(f"the adapted parameters could not be written: {error}; they are in {archive}")
    return RunResult(outcome, archive, report, parameters, tuple(trouble))


def _told(error: Exception) -> str:
    """What the operator is told of what ended a run."""
    if isinstance(error, JournalError):
        return f"the record could not be written: {error}"
    return str(error) if isinstance(error, _EXPECTED) else f"{type(error).__name__}: {error}"


def _parameters(archive: Path) -> Path | None:
    from rig.experiment.online_parameters import write_parameters
    from runs.run import Run

    return write_parameters(Run(archive))


def header(request: RunRequest, decided: Plan, t_ns: int, ahead_ns: int = 0) -> RunHeader:
    """Everything known about a run before its first sample, which is due at `t_ns`, so long from now."""
    now = datetime.now(UTC) + timedelta(microseconds=ahead_ns / 1e3)
    commit, diff = git_state()
    config, protocol = request.config, request.protocol
    return RunHeader(
        run_id=free_id(request.folder, f"{now.astimezone():%Y%m%d-%H%M%S}-{protocol.name}"),
        title=protocol.title,
        started_utc_ns=int(now.timestamp() * 1e9),
        started_t_ns=t_ns,
        protocol_name=protocol.name,
        protocol_yaml=protocol.text,
        rig_name=config.name,
        rig_yaml=request.rig_text,
        protocol_files=tuple(SourceFile.of(name, "csv", text) for name, text in protocol.files.items()),
        sources=request.sources,
        parameters_yaml=request.parameters_text,
        actuators=config.actuators,
        valves=len(config.valves),
        executor="virtual time" if request.fast else "real time",
        simulated=config.simulated,
        seed=request.seed if config.simulated else None,
        model_variant=request.variant,
        operator=request.operator,
        notes=request.notes,
        command=shlex.join(sys.argv),
        host=platform.node(),
        versions=versions(),
        git_commit=commit,
        git_diff=diff,
        intervals=_intervals(decided.trajectory),
        quantities=quantities(config),
        adapted=decided.adapted,
        control_hz=config.control.rate_hz,
        camera_hz=next(iter(config.cameras.values())).rate_hz,
        cameras=tuple(config.cameras),
    )


def _intervals(trajectory: Trajectory) -> tuple[Interval, ...]:
    return tuple(
        Interval(s.start_s, s.stop_s, s.kind, s.label, tuple(float(p) for p in s.level_pa)) for s in trajectory.segments
    )


def free_id(folder: Path, stem: str) -> str:
    """A run id that no file of the folder has: two runs can begin within one second."""
    candidate, n = stem, 1
    while any(folder.glob(f"{candidate}.*")):
        n += 1
        candidate = f"{stem}-{n}"
    return candidate
