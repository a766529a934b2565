"""One prepared run: lock, arm, run, make safe, finalise."""

from __future__ import annotations

import platform
import shutil
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

from protocols import SetPointTrajectory
from rig.config.loader import Source
from rig.execution.plan import UNRECORDED, OperatorInterface, RunPlan, StartError, valve_units
from rig.experiment import report_process
from rig.experiment.prepare import PreparedRun
from rig.experiment.provenance import protocol_parameters, quantities, section_places, software
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
    RecordedFile,
    RunFooter,
    RunHeader,
    Status,
    StudyRole,
)

if TYPE_CHECKING:
    from runs.journal.journal import JournalWriter
    from runs.summary import Summary

SPARE_DISK_BYTES = 200_000_000
DISK_WARNING_AFTER_S = 2.0
"""Time for the disk to store the end of the journal before the operator sees a warning."""
_EXPECTED = (CardError, StartError, JournalError)


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


def run(
    prepared: PreparedRun,
    operator: OperatorInterface,
    begin_report: report_process.BeginReport = report_process.begin_here,
) -> RunResult:
    """Run and write an archive, whatever ends the run; `begin_report` begins the report of the archive.

    Raises:
        CardError, StartError, JournalError: the run did not start; the valves are safe and no archive exists.
    """
    prepared.folder.mkdir(parents=True, exist_ok=True)
    if (free := shutil.disk_usage(prepared.folder).free) < SPARE_DISK_BYTES:
        raise StartError(
            f"{prepared.folder}: only {free / 1e6:.0f} MB free, a run needs {SPARE_DISK_BYTES / 1e6:.0f} MB"
        )
    # Imported here: `rig check` needs neither HDF5 nor MCAP, and a run that ends should not wait for them.
    from runs.archive.writer import ArchiveError, finalise
    from runs.run import Run
    from runs.summary import summarise

    outcome, journal = _execute(prepared, operator)
    archive = report = parameters = summary = None
    warnings: list[str] = []
    try:
        if not journal.wait_until_synced(DISK_WARNING_AFTER_S):
            waiting = f"waiting for the disk to take the rest of {journal.path}"
            operator.report(Event(time.monotonic_ns(), Level.WARNING, "supervisor", waiting))
        journal.close(outcome)
        archive = finalise(journal.path)
    except (ArchiveError, JournalError) as error:
        warnings.append(f"{error}; the journal is kept: {journal.path}; run `rig recover {prepared.folder}` later")
    finish_report = begin_report(archive) if archive is not None and prepared.options.report else None
    if archive is not None:
        summary = summarise(Run(archive))
    if finish_report is not None:
        try:
            report = finish_report()
        except OSError as error:
            warnings.append(f"no report: {error}; run `rig report {archive}` later")
    if archive is not None and prepared.plan.adapted:
        from rig.experiment.online_parameters import write_parameters

        try:
            parameters = write_parameters(Run(archive))
        except OSError as error:
            warnings.append(f"the adapted parameters could not be written: {error}; they are in {archive}")
    return RunResult(outcome, archive, report, summary, parameters, tuple(warnings))


def _execute(prepared: PreparedRun, operator: OperatorInterface) -> tuple[RunFooter, JournalWriter]:
    """Run the plan; an error after the journal was created ends the run as aborted."""
    if prepared.options.fast:
        from rig.virtual.executor import run as execute
    else:
        from rig.realtime.supervisor import run as execute
    from runs.journal.journal import JournalWriter

    patience_s = timing_limits(prepared.config, obtainable()).disk_s
    journal: JournalWriter | None = None

    def armed(t_ns: int) -> JournalWriter:
        nonlocal journal
        # The first control cycle lies in the future; virtual time starts now.
        ahead_ns = 0 if prepared.options.fast else t_ns - time.monotonic_ns()
        about = header(prepared, t_ns, ahead_ns)
        while journal is None:
            path = prepared.folder / f"{about.run_id}.mcap"
            try:
                journal = JournalWriter(path, about, live=not prepared.options.fast, patience_s=patience_s)
            except JournalExistsError:  # another process has taken the id since
                about = replace(about, run_id=free_id(prepared.folder, about.run_id))
        if prepared.rig_source in (Source.ENVIRONMENT, Source.FOLDER):
            # The recorded command does not contain the rig.
            message = f"the rig is {prepared.rig_file.absolute()}, chosen by {prepared.rig_source}"
            journal.event(Event(t_ns, Level.INFO, "supervisor", message))
        return journal

    with _bench(prepared) as plan:
        try:
            outcome = execute(plan, armed, operator)
        except Exception as error:
            if journal is None:
                raise
            # In virtual time the newest record gives the time.
            ended_ns = journal.newest_t_ns if prepared.options.fast else time.monotonic_ns()
            outcome = RunFooter(ended_ns, Status.ABORTED, _abort_message(error))
            with suppress(JournalError):
                if not isinstance(error, _EXPECTED):
                    journal.event(Event(ended_ns, Level.FAULT, "supervisor", traceback.format_exc()))
    assert journal is not None
    return outcome, journal


@contextmanager
def _bench(prepared: PreparedRun) -> Iterator[RunPlan]:
    """The plan on the cards of this run: real ones are locked, simulated ones its own."""
    if prepared.options.fast:
        yield prepared.plan
        return
    with own_devices(prepared.config) as config, cards_locked(config, f"protocol {prepared.protocol.name}"):
        yield replace(prepared.plan, config=config)


def _abort_message(error: Exception) -> str:
    """Return the message of the error that ended a run."""
    if isinstance(error, JournalError):
        return f"{UNRECORDED}: {error}"
    return str(error) if isinstance(error, _EXPECTED) else f"{type(error).__name__}: {error}"


def header(prepared: PreparedRun, t_ns: int, ahead_ns: int = 0) -> RunHeader:
    """Return the header of a run whose first sample is due at `t_ns`, `ahead_ns` from now."""
    now = datetime.now(UTC) + timedelta(microseconds=ahead_ns / 1e3)
    config, protocol, plan = prepared.config, prepared.protocol, prepared.plan
    return RunHeader(
        run_id=free_id(prepared.folder, f"{now.astimezone():%Y%m%d-%H%M%S}-{_id_ending(prepared)}"),
        title=protocol.title,
        started_utc_ns=int(now.timestamp() * 1e9),
        started_t_ns=t_ns,
        protocol_name=protocol.name,
        protocol_yaml=protocol.text,
        rig_name=config.name,
        rig_yaml=prepared.rig.text,
        protocol_files=tuple(RecordedFile.of(name, "csv", text) for name, text in protocol.files.items()),
        calibrations=prepared.rig.calibrations,
        parameters_yaml=prepared.rig.parameters,
        actuators=config.actuators,
        valves=len(config.valves),
        executor="virtual time" if prepared.options.fast else "real time",
        simulated=config.simulated,
        seed=plan.seed if any(device.driven_by.simulated for device in config.devices) else None,
        model_variant=plan.variant,
        operator=prepared.options.operator,
        notes=prepared.options.note,
        host=platform.node(),
        metadata=dict(prepared.metadata),
        **software(),
        intervals=_intervals(plan.trajectory),
        quantities=(*protocol_parameters(protocol), *quantities(config)),
        adapted=plan.adapted,
        tip_controller=plan.tip_controller,
        learned_from=plan.learned_from,
        streams=bool(plan.trajectory.streams),
        control_hz=config.control.rate_hz,
        camera_hz=config.observation_hz,
        cameras=tuple(config.cameras),
        triggered=config.triggered,
        sections=section_places(config),
        tracker=next(iter(config.trackers), ""),
        auxiliary=plan.auxiliary,
        valve_units=valve_units(config),
        study=prepared.study,
    )


def _id_ending(prepared: PreparedRun) -> str:
    if (place := prepared.study) is None:
        return prepared.protocol.name
    role = "" if place.role is StudyRole.RUN else f"-{place.role}"
    return f"{place.study}-{place.number:03d}{role}"


def _intervals(trajectory: SetPointTrajectory) -> tuple[PlayedSegment, ...]:
    return tuple(
        PlayedSegment(s.start_s, s.stop_s, s.kind, s.label, tuple(float(p) for p in s.level_pa))
        for s in trajectory.segments
    )
