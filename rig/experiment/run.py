"""One run, start to finish: check, lock, arm, run, make safe, finalise."""

from __future__ import annotations

import platform
import shutil
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import protocols
from protocols import BadInputError, Problem, Protocol, SetPointTrajectory
from protocols.arguments import text_problems, whole_number_problems
from protocols.problems import bad_input
from rig.config.loader import RigChoice, RigFile, Source, read
from rig.config.schema import RigConfig
from rig.config.sections import Variant, variant_named
from rig.execution.plan import UNRECORDED, OperatorInterface, RunPlan, StartError, require_mocks, valve_units
from rig.experiment import report_process
from rig.experiment.preflight import check
from rig.experiment.provenance import protocol_parameters, quantities, section_places, software
from rig.experiment.tip_setup import tip_controller, tip_inverse
from rig.hardware.cards.base import CardError
from rig.hardware.lock import cards_locked
from rig.realtime.scheduling import obtainable
from rig.realtime.timing_limits import timing_limits
from rig.simulator.plant_launcher import own_devices
from runs.data_folder import free_id
from runs.journal.append_only_file import JournalError, JournalExistsError
from runs.records import (
    Event,
    Level,
    PlayedSegment,
    Quantity,
    RecordedFile,
    RunFooter,
    RunHeader,
    Status,
    StudyRole,
    StudyRun,
)

if TYPE_CHECKING:
    from rig.config.parameters_overlay import Parameters
    from runs.journal.journal import JournalWriter
    from runs.summary import Summary

Loaded = TypeVar("Loaded")
Name = TypeVar("Name")
SPARE_DISK_BYTES = 200_000_000
DISK_WARNING_AFTER_S = 2.0
"""Time for the disk to store the end of the journal before the operator sees a warning."""
_EXPECTED = (CardError, StartError, JournalError)


@dataclass(frozen=True)
class RunRequest:
    """The operator's request for a run."""

    protocol: Protocol
    rig: RigFile
    fast: bool
    seed: int
    folder: Path
    variant: Variant
    operator: str = ""
    notes: str = ""
    report: bool = True
    adapted: tuple[Quantity, ...] = ()
    rig_source: Source = Source.OPTION
    metadata: Mapping[str, str] = field(default_factory=dict)
    controller: str | None = None
    """Name of the tip controller; that of the rig when None."""
    learn_from: tuple[Path, ...] = ()
    """Archives of earlier runs from which the tip controller learns."""
    study: StudyRun | None = None

    @property
    def config(self) -> RigConfig:
        """Configuration of the rig."""
        return self.rig.config

    @property
    def rig_file(self) -> Path:
        """Path of the rig file."""
        return Path(self.rig.file)


@dataclass(frozen=True)
class RunResult:
    """Files of a run; `archive` is None when it did not start, `report` when none was written."""

    outcome: RunFooter
    archive: Path | None
    report: Path | None
    summary: Summary | None = None
    """The summary of the archive."""
    parameters: Path | None = None
    """The parameters that the recursive estimator identified, if one ran."""
    warnings: tuple[str, ...] = ()
    """Errors after the run: the archive, the report or the parameters could not be written."""


def request(
    protocol: str | Protocol,
    rig: str | RigChoice,
    *,
    settings: Mapping[str, float] | None = None,
    folder: Path = Path("data"),
    fast: bool = False,
    seed: int = 0,
    variant: str | None = None,
    operator: str = "",
    notes: str = "",
    report: bool = True,
    parameters: Path | None = None,
    adapt: Sequence[str] | None = None,
    metadata: Mapping[str, str | float] | None = None,
    controller: str | None = None,
    learn_from: Sequence[Path] = (),
) -> RunRequest:
    """Load a protocol and a rig by name or file, with a file of identified `parameters` over the rig.

    A `protocol` may be loaded already, as by `protocols.from_steps`. `settings` are values of the protocol's
    parameters, by name, in the unit of each.
    `adapt` names the parameters that a recursive estimator identifies online: the default ones when empty, none
    when None. `metadata` overrides that of the rig file; with it, even if empty, the required names must have a value.

    Raises:
        UnknownParameter, NotEstimableError: a name is unknown or cannot be estimated online.
        BadInputError: every problem of protocol, rig and parameters.
    """
    source = rig.source if isinstance(rig, RigChoice) else Source.OPTION
    rig = rig.name if isinstance(rig, RigChoice) else rig
    problems = [*text_problems({"--operator": operator, "--note": notes}), *whole_number_problems("--seed", seed, 0)]
    loaded_protocol = _collecting(problems, partial(_loaded, settings=settings), protocol)
    chosen = _collecting(problems, variant_named, variant)
    identified = None if parameters is None else _collecting(problems, _read_parameters, parameters)
    rig_read = _collecting(problems, partial(read, parameters=identified, variant=chosen), rig)
    stated: dict[str, str] = {}
    if rig_read is not None:
        stated, missing = rig_read.run_metadata({} if metadata is None else metadata)
        problems += missing if metadata is not None else ()
    if problems or loaded_protocol is None or rig_read is None:
        raise BadInputError(problems)
    config = rig_read.config
    variant_used = chosen or config.model.variant
    return RunRequest(
        protocol=loaded_protocol,
        rig=rig_read,
        fast=fast,
        seed=int(seed),
        folder=folder,
        variant=variant_used,
        operator=operator,
        notes=notes,
        report=report,
        adapted=() if adapt is None else _estimated_online(config, variant_used, adapt),
        rig_source=source,
        metadata=stated,
        controller=controller,
        learn_from=tuple(learn_from),
    )


def _read_parameters(file: Path) -> Parameters:
    from rig.config import parameters_overlay

    return parameters_overlay.read(file)


def _loaded(protocol: str | Protocol, settings: Mapping[str, float] | None) -> Protocol:
    """The protocol, loaded unless it is; or `BadInputError`."""
    if not isinstance(protocol, Protocol):
        return protocols.load(protocol, settings)
    if settings:
        expected = (
            f"no values: protocol {protocol.name} is loaded, and its parameters have theirs; protocols.load sets them"
        )
        raise bad_input("--set", ", ".join(settings), expected)
    return protocol


def _estimated_online(config: RigConfig, variant: Variant, names: Sequence[str]) -> tuple[Quantity, ...]:
    """The parameters that are estimated during the run; the default ones without names. Raises as `request` does."""
    if not config.measures_tip:
        expected = (
            f"a rig with a camera or tracker: rig {config.name} has none, so there is no measured tip to estimate from"
        )
        raise bad_input("--adapt", "an online estimation", expected)
    measured = [name for name, one in config.inputs.items() if one.tip_force_direction is not None]
    if measured:
        expected = f"a rig that does not measure the tip force: the estimator does not use input {measured[0]}"
        raise bad_input("--adapt", "an online estimation", expected)
    from rig.observation.online_estimation import default_parameters, estimated_quantities

    return estimated_quantities(config, variant, names or default_parameters(config, variant))


def _collecting(problems: list[Problem], read: Callable[[Name], Loaded], name: Name) -> Loaded | None:
    try:
        return read(name)
    except BadInputError as bad:
        problems.extend(bad.problems)
        return None


def plan(request: RunRequest) -> RunPlan:
    """Expand and check a request without touching any device.

    Raises:
        BadInputError: every violated limit, or the reasons why the rig cannot run the protocol.
    """
    if request.fast:
        rig = request.config
        require_mocks(rig.name, {**rig.cards, **rig.cameras, **rig.trackers})
    inverse, learned_from = tip_inverse(request.protocol, request.rig, request.variant, request.learn_from)
    trajectory = request.protocol.expand(request.config.actuators, inverse)
    if request.fast and trajectory.streams:
        where, column = request.protocol.step_at(trajectory.streams[0].line)
        expected = "real time: virtual time cannot wait for another program; a step csv plays set-points of a file"
        line = trajectory.streams[0].line
        raise BadInputError([Problem(trajectory.source, line, column, where, "virtual time (--fast)", expected)])
    if problems := check(request.config, trajectory, request.protocol, request.rig_file):
        raise BadInputError(problems)
    return RunPlan(
        request.config,
        request.rig_file,
        trajectory,
        request.variant,
        request.seed,
        request.adapted,
        tip_controller(request.config, request.rig_file, request.controller, bool(trajectory.tip)),
        learned_from,
    )


def run(
    request: RunRequest,
    decided: RunPlan,
    operator: OperatorInterface,
    begin_report: report_process.BeginReport = report_process.begin_here,
) -> RunResult:
    """Run a plan and write an archive, whatever ends the run; `begin_report` begins the report of the archive.

    Raises:
        CardError, StartError, JournalError: the run did not start; the valves are safe and no archive exists.
    """
    request.folder.mkdir(parents=True, exist_ok=True)
    if (free := shutil.disk_usage(request.folder).free) < SPARE_DISK_BYTES:
        raise StartError(
            f"{request.folder}: only {free / 1e6:.0f} MB free, a run needs {SPARE_DISK_BYTES / 1e6:.0f} MB"
        )
    # Imported here: `rig check` needs neither HDF5 nor MCAP, and a run that ends should not wait for them.
    from runs.archive.writer import ArchiveError, finalise
    from runs.run import Run
    from runs.summary import summarise

    outcome, journal = _execute(request, decided, operator)
    archive = report = parameters = summary = None
    warnings: list[str] = []
    try:
        if not journal.wait_until_synced(DISK_WARNING_AFTER_S):
            waiting = f"waiting for the disk to take the rest of {journal.path}"
            operator.report(Event(time.monotonic_ns(), Level.WARNING, "supervisor", waiting))
        journal.close(outcome)
        archive = finalise(journal.path)
    except (ArchiveError, JournalError) as error:
        warnings.append(f"{error}; the journal is kept: {journal.path}; run `rig recover {request.folder}` later")
    finish_report = begin_report(archive) if archive is not None and request.report else None
    if archive is not None:
        summary = summarise(Run(archive))
    if finish_report is not None:
        try:
            report = finish_report()
        except OSError as error:
            warnings.append(f"no report: {error}; run `rig report {archive}` later")
    if archive is not None and decided.adapted:
        from rig.experiment.online_parameters import write_parameters

        try:
            parameters = write_parameters(Run(archive))
        except OSError as error:
            warnings.append(f"the adapted parameters could not be written: {error}; they are in {archive}")
    return RunResult(outcome, archive, report, summary, parameters, tuple(warnings))


def _execute(request: RunRequest, decided: RunPlan, operator: OperatorInterface) -> tuple[RunFooter, JournalWriter]:
    """Run the plan; an error after the journal was created ends the run as aborted."""
    if request.fast:
        from rig.virtual.executor import run as execute
    else:
        from rig.realtime.supervisor import run as execute
    from runs.journal.journal import JournalWriter

    patience_s = timing_limits(decided.config, obtainable()).disk_s
    journal: JournalWriter | None = None

    def armed(t_ns: int) -> JournalWriter:
        nonlocal journal
        # The first control cycle lies in the future; virtual time starts now.
        ahead_ns = 0 if request.fast else t_ns - time.monotonic_ns()
        about = header(request, decided, t_ns, ahead_ns)
        while journal is None:
            path = request.folder / f"{about.run_id}.mcap"
            try:
                journal = JournalWriter(path, about, live=not request.fast, patience_s=patience_s)
            except JournalExistsError:  # another process has taken the id since
                about = replace(about, run_id=free_id(request.folder, about.run_id))
        if request.rig_source in (Source.ENVIRONMENT, Source.FOLDER):
            # The recorded command does not contain the rig.
            message = f"the rig is {request.rig_file.absolute()}, chosen by {request.rig_source}"
            journal.event(Event(t_ns, Level.INFO, "supervisor", message))
        return journal

    with _bench(request, decided) as prepared:
        try:
            outcome = execute(prepared, armed, operator)
        except Exception as error:
            if journal is None:
                raise
            # In virtual time the newest record gives the time.
            ended_ns = journal.newest_t_ns if request.fast else time.monotonic_ns()
            outcome = RunFooter(ended_ns, Status.ABORTED, _abort_message(error))
            with suppress(JournalError):
                if not isinstance(error, _EXPECTED):
                    journal.event(Event(ended_ns, Level.FAULT, "supervisor", traceback.format_exc()))
    assert journal is not None
    return outcome, journal


@contextmanager
def _bench(request: RunRequest, decided: RunPlan) -> Iterator[RunPlan]:
    """The plan on the cards of this run: real ones are locked, simulated ones its own."""
    if request.fast:
        yield decided
        return
    with own_devices(decided.config) as config, cards_locked(config, f"protocol {request.protocol.name}"):
        yield replace(decided, config=config)


def _abort_message(error: Exception) -> str:
    """Return the message of the error that ended a run."""
    if isinstance(error, JournalError):
        return f"{UNRECORDED}: {error}"
    return str(error) if isinstance(error, _EXPECTED) else f"{type(error).__name__}: {error}"


def header(request: RunRequest, decided: RunPlan, t_ns: int, ahead_ns: int = 0) -> RunHeader:
    """Return the header of a run whose first sample is due at `t_ns`, `ahead_ns` from now."""
    now = datetime.now(UTC) + timedelta(microseconds=ahead_ns / 1e3)
    config, protocol = request.config, request.protocol
    return RunHeader(
        run_id=free_id(request.folder, f"{now.astimezone():%Y%m%d-%H%M%S}-{_id_ending(request)}"),
        title=protocol.title,
        started_utc_ns=int(now.timestamp() * 1e9),
        started_t_ns=t_ns,
        protocol_name=protocol.name,
        protocol_yaml=protocol.text,
        rig_name=config.name,
        rig_yaml=request.rig.text,
        protocol_files=tuple(RecordedFile.of(name, "csv", text) for name, text in protocol.files.items()),
        calibrations=request.rig.calibrations,
        parameters_yaml=request.rig.parameters,
        actuators=config.actuators,
        valves=len(config.valves),
        executor="virtual time" if request.fast else "real time",
        simulated=config.simulated,
        seed=request.seed if config.has_simulated_drivers else None,
        model_variant=request.variant,
        operator=request.operator,
        notes=request.notes,
        host=platform.node(),
        metadata=dict(request.metadata),
        **software(),
        intervals=_intervals(decided.trajectory),
        quantities=(*protocol_parameters(protocol), *quantities(config)),
        adapted=decided.adapted,
        tip_controller=decided.tip_controller,
        learned_from=decided.learned_from,
        streams=bool(decided.trajectory.streams),
        control_hz=config.control.rate_hz,
        camera_hz=config.observation_hz,
        cameras=tuple(config.cameras),
        triggered=config.triggered,
        sections=section_places(config),
        tracker=next(iter(config.trackers), ""),
        auxiliary=decided.auxiliary,
        valve_units=valve_units(config),
        study=request.study,
    )


def _id_ending(request: RunRequest) -> str:
    if (place := request.study) is None:
        return request.protocol.name
    role = "" if place.role is StudyRole.RUN else f"-{place.role}"
    return f"{place.study}-{place.number:03d}{role}"


def _intervals(trajectory: SetPointTrajectory) -> tuple[PlayedSegment, ...]:
    return tuple(
        PlayedSegment(s.start_s, s.stop_s, s.kind, s.label, tuple(float(p) for p in s.level_pa))
        for s in trajectory.segments
    )
