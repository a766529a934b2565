"""Build an archive with the layout of a run's from a foreign table and its mapping."""

from __future__ import annotations

import platform
import re
import time
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.gravity import GravityDirection
from model.arrays import Array
from model.units import PA_PER_BAR
from protocols import arguments
from protocols.problems import BadInputError, raise_all
from protocols.source_positions import Document
from rig.config import loader
from rig.config.calibration_files import sha256_of
from rig.experiment.provenance import software
from rig.importing.gravity import gravity_calibration, measured_gravity, warn_if_opposite
from rig.importing.mapping import Mapping, load
from rig.importing.pressure_columns import AppliedDelay, delayed, pressure_delay, pressures, setpoints
from rig.importing.tables import ColumnReader
from rig.importing.tables import read as read_table
from rig.importing.timestamps import RowTimes, times
from rig.importing.tracker_frames import PlacedTips, tips_in_base, wrench
from rig.importing.units import KILOGRAMS, VOLTS
from runs.archive.writer import finalise
from runs.data_folder import DATA, free_id
from runs.export.exporters import SIMULATED
from runs.journal.journal import SUFFIX, JournalWriter
from runs.records import (
    GRAVITY_DIRECTION,
    DetectionStatus,
    Event,
    Level,
    Quantity,
    RecordedFile,
    RunFooter,
    RunHeader,
    Status,
    blank,
    observation_dtype,
    sample_dtype,
)

EVEN = 0.25
"""Tolerance for even time steps, as a part of the period."""
CLOSEST_S, HIGHEST_BAR, TIP_M, TIP_LENGTHS = 2e-4, 50.0, (1e-3, 5.0), (0.1, 3.0)
"""Beyond these values rows, pressures or tips (from the base, or in arm lengths) likely have another unit."""

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class ImportResult:
    """Result of an import: the archive, and its warnings, which it stores as events."""

    archive: Path
    warnings: tuple[str, ...]


def import_table(
    data: Path, mapping_file: Path, folder: Path | str = DATA, operator: str = "", notes: str = ""
) -> ImportResult:
    """Write the archive of a foreign table.

    A fault that leaves the data usable becomes a warning, stored as an event of the archive.

    Raises:
        BadInputError: every problem of the mapping and the data.
    """
    raise_all(arguments.text_problems({"--operator": operator, "--note": notes}))
    data, mapping_file = arguments.path("DATA", data), arguments.path("--mapping", mapping_file)
    folder = arguments.folder("--out", folder)
    mapping, document = load(mapping_file)
    columns = ColumnReader(read_table(data, mapping.file))
    found = _read(data, columns, mapping, document)
    folder.mkdir(parents=True, exist_ok=True)
    source = f"{data.name}, SHA-256 {sha256_of(data)}"
    header = replace(
        _header(found, columns, mapping, document),
        run_id=free_id(folder, f"{datetime.now(UTC).astimezone():%Y%m%d-%H%M%S}-{_word(data.stem)}"),
        operator=operator,
        notes="; ".join(filter(None, (notes, f"imported from {source}"))),
    )
    made_of = f"{len(found.samples)} rows from {source}, by mapping {mapping_file.name}"
    if found.delay.delay_s:
        made_of += f"; pressures delayed by {found.delay.delay_s:.3f} s ({found.delay.source})"
    journal = JournalWriter(folder / f"{header.run_id}{SUFFIX}", header)
    journal.samples(found.samples)
    journal.observations(found.observations)
    journal.event(Event(header.started_t_ns, Level.INFO, "import", made_of))
    for warning in columns.warnings:
        journal.event(Event(header.started_t_ns, Level.WARNING, "import", warning))
    journal.close(RunFooter(int(found.samples["t_ns"][-1]), Status.FINISHED, ""))
    return ImportResult(finalise(journal.path), tuple(columns.warnings))


@dataclass(frozen=True)
class _Measurement:
    """What a table and its mapping say: the rows of the archive, in SI units, and what holds for all of them."""

    rig: loader.RigFile | None
    started_utc_ns: int
    samples: NDArray[np.void]
    observations: NDArray[np.void]
    ambient_pa: Array
    delay: AppliedDelay
    gravity: GravityDirection | None


def _read(data: Path, columns: ColumnReader, mapping: Mapping, document: Document) -> _Measurement:
    """Read and check every column that the mapping names."""
    rig = _rig(mapping, document)
    length_m = None if rig is None else rig.config.arm.length_mm * 1e-3
    read = times(columns, mapping)
    t_ns = read.t_ns
    gauge_pa, ambient_pa = pressures(columns, mapping)
    tips = tips_in_base(columns, mapping)
    delay = pressure_delay(columns, mapping, document, (t_ns - t_ns[0]) * 1e-9, gauge_pa, tips.tip_m)
    gauge_pa = delayed(t_ns, gauge_pa, delay.delay_s)
    setpoint_pa, valve_v, weight_kg = setpoints(columns, mapping), _valves(columns, mapping), _weight(columns, mapping)
    pull = wrench(columns, mapping)
    gravity = measured_gravity(columns, mapping, document, (t_ns - t_ns[0]) * 1e-9, weight_kg)
    columns.check()
    if gravity is not None and rig is not None:
        warn_if_opposite(columns, gravity, rig)
        measured = gravity_calibration(gravity, data)
        rig = rig.calibrated_as([RecordedFile.of(measured.source.file, measured.found.kind, measured.source.text)])
    _warn_of_implausible_values(columns, t_ns, gauge_pa, tips.tip_m, length_m)
    started_utc_ns = _started_utc_ns(columns, mapping, document, read)
    samples = _samples(t_ns, _frames(columns, t_ns), setpoint_pa, gauge_pa, valve_v)
    observations = _observations(samples, tips, weight_kg)
    observations["force_n"], observations["moment_n_m"] = pull[:, :3], pull[:, 3:]
    return _Measurement(rig, started_utc_ns, samples, observations, ambient_pa, delay, gravity)


def _header(found: _Measurement, columns: ColumnReader, mapping: Mapping, document: Document) -> RunHeader:
    """Return the header of the archive, without what the import itself adds: id, operator and notes."""
    rig, t_ns = found.rig, found.samples["t_ns"]
    rate_hz = 1e9 / float(np.median(np.diff(t_ns)))
    mapping_file = Path(document.file)
    return RunHeader(
        run_id="",
        title=mapping.title,
        started_utc_ns=found.started_utc_ns,
        started_t_ns=int(t_ns[0]),
        protocol_name=f"import {mapping_file.stem}",
        # The mapping takes the place of the protocol.
        protocol_yaml=document.text,
        rig_name="" if rig is None else rig.config.name,
        rig_yaml="" if rig is None else rig.text,
        calibrations=() if rig is None else rig.calibrations,
        actuators=mapping.actuators,
        valves=found.samples["valve_v"].shape[1],
        executor="imported",
        simulated=_simulated(columns, mapping),
        host=platform.node(),
        **software(),
        quantities=_quantities(mapping, mapping_file, found),
        control_hz=rate_hz,
        camera_hz=rate_hz,
    )


def _samples(t_ns: Ints, frame: Ints, setpoint_pa: Array, gauge_pa: Array, valve_v: Array) -> NDArray[np.void]:
    """One control cycle per row (n,), never late."""
    samples = blank(len(t_ns), sample_dtype(gauge_pa.shape[1], valve_v.shape[1]))
    samples["t_ns"], samples["cycle"], samples["scans"] = t_ns, frame, 1
    samples["protocol_s"] = (t_ns - t_ns[0]) * 1e-9
    samples["setpoint_pa"], samples["measured_pa"], samples["valve_v"] = setpoint_pa, gauge_pa, valve_v
    return samples


def _observations(samples: NDArray[np.void], tips: PlacedTips, weight_kg: Array) -> NDArray[np.void]:
    """One frame per row (n,), without a model."""
    rows = blank(len(samples), observation_dtype(samples["measured_pa"].shape[1]))
    rows["t_ns"], rows["frame"], rows["protocol_s"] = samples["t_ns"], samples["cycle"], samples["protocol_s"]
    rows["dropped"] = np.diff(samples["cycle"], prepend=-1) - 1
    rows["pressure_pa"], rows["weight_kg"] = samples["measured_pa"], weight_kg
    rows["measured_m"], rows["covariance_m2"] = tips.tip_m, tips.covariance[:, :3, :3]
    known = np.isfinite(tips.rotation).all(axis=(1, 2))
    if known.any():
        rows["orientation_rad"][known] = Rotation.from_matrix(tips.rotation[known]).as_rotvec()
        rows["orientation_covariance_rad2"][known] = tips.covariance[known, 3:, 3:]
        rows["cross_covariance_m_rad"][known] = tips.covariance[known, :3, 3:]
    unseen = ~np.isfinite(rows["measured_m"]).all(axis=1)
    rows["seen"] = np.where(unseen, DetectionStatus.NO_FRAME, DetectionStatus.MEASURED)
    rows["camera_seen"] = rows["seen"][:, None]
    for name in ("measured_m", "covariance_m2", "orientation_rad", "orientation_covariance_rad2"):
        rows[name][unseen] = np.nan
    rows["cross_covariance_m_rad"][unseen] = np.nan
    return rows


def _warn_of_implausible_values(
    columns: ColumnReader, t_ns: Ints, gauge_pa: Array, tip_m: Array, length_m: float | None
) -> None:
    """Warn of values that are implausible for a soft arm."""
    step_s = float(np.median(np.diff(t_ns))) * 1e-9
    if step_s < CLOSEST_S:
        columns.warn(f"the rows follow each other by {1e6 * step_s:.3g} us: is the unit of the time right?")
    highest_bar = float(np.nanmax(gauge_pa, initial=0.0)) / PA_PER_BAR
    if highest_bar > HIGHEST_BAR:
        columns.warn(f"the pressures reach {highest_bar:.3g} bar: is their unit right?")
    seen = tip_m[np.isfinite(tip_m).all(axis=1)]
    if not len(seen):
        return
    far_m = float(np.median(np.linalg.norm(seen, axis=1)))
    nearest, farthest = TIP_M if length_m is None else (length_m * share for share in TIP_LENGTHS)
    if not nearest <= far_m <= farthest:
        arm = "" if length_m is None else f", and the rig's arm is {1e3 * length_m:.4g} mm long"
        columns.warn(f"the tip lies {1e3 * far_m:.3g} mm from the base{arm}: are unit, base and frame right?")


def _rig(mapping: Mapping, document: Document) -> loader.RigFile | None:
    """Return the rig that the mapping names; None where it names none."""
    if mapping.rig is None:
        return None
    beside = Path(document.file).parent / mapping.rig
    name = str(beside) if beside.is_file() else mapping.rig
    found = loader.read(name)
    if found.config.actuators != mapping.actuators:
        value = f"{mapping.rig}, which has {found.config.actuators} actuators"
        expected = f"a rig with {mapping.actuators} actuators, as there are pressures"
        raise BadInputError([document.problem(("rig",), expected, value)])
    return found


def _started_utc_ns(columns: ColumnReader, mapping: Mapping, document: Document, read: RowTimes) -> int:
    """Moment of the first row, since 1970: as the mapping states it or the rows themselves do."""
    stated = mapping.started_utc_ns
    if read.utc and stated is not None:
        expected = "no such key: the times themselves are dates with their distance from UTC"
        raise BadInputError([document.problem(("started",), expected)])
    if read.utc:
        return int(read.t_ns[0])
    if stated is None:
        columns.warn("the mapping does not say when the measurement began: start_time is that of the import")
        return time.time_ns()
    return stated


def _simulated(columns: ColumnReader, mapping: Mapping) -> bool:
    """Whether nothing was measured: the mapping says so, or the column does with which `rig export` marks its rows."""
    if mapping.simulated:
        return True
    try:
        marked = (columns.table.numbers(SIMULATED) > 0).any()
    except BadInputError:
        return False
    if marked:
        columns.warn(f"column {SIMULATED} says that these rows were not measured: the archive says so, too")
    return bool(marked)


def _frames(columns: ColumnReader, t_ns: Ints) -> Ints:
    """Numbers of the rows (n,), which leave out those that are missing from even time steps."""
    steps = np.diff(t_ns) / np.median(np.diff(t_ns))
    whole = np.round(steps).astype(np.int64)
    if (np.abs(steps - whole) > EVEN).any() or (whole < 1).any():
        low, high = np.diff(t_ns).min() * 1e-9, np.diff(t_ns).max() * 1e-9
        columns.warn(f"the time steps are uneven, from {low:.6g} to {high:.6g} s: rows are numbered one by one")
        return np.arange(len(t_ns))
    if len(gaps := np.flatnonzero(whole > 1)):
        where = columns.table.place(int(gaps[0]))
        columns.warn(f"{int((whole - 1).sum())} rows are missing from even time steps, the first after {where}")
    return np.concatenate([[0], np.cumsum(whole)])


def _valves(columns: ColumnReader, mapping: Mapping) -> Array:
    """Voltages (n, V), or one row of none."""
    if mapping.valves is None:
        return np.empty((1, 0))
    return columns.read_columns(mapping.valves.columns, [VOLTS[mapping.valves.unit]] * len(mapping.valves.columns))


def _weight(columns: ColumnReader, mapping: Mapping) -> Array:
    """Return weights (n,) [kg]; zero where the file has none."""
    if mapping.weight is None:
        return np.zeros(1)
    weight = columns.read_columns((mapping.weight.column,), (KILOGRAMS[mapping.weight.unit],))[:, 0]
    columns.warn_missing(weight, "the weight")
    return weight


def _quantities(mapping: Mapping, file: Path, measured: _Measurement) -> tuple[Quantity, ...]:
    """Every number that the import used."""
    source = f"mapping {file.name}"
    stated, place, gravity, delay = mapping.pressures, mapping.frame, measured.gravity, measured.delay
    found = [
        Quantity("calibration", "frame_translation", place.translation_mm, "mm", source, place.translation_std_mm),
        Quantity("calibration", "frame_rotation", place.rotation_deg, "deg", source, place.rotation_std_deg),
    ]
    if stated.reading == "absolute":
        how = f"mean of the first {stated.ambient_rows} rows" if stated.ambient_rows else source
        ambient = tuple(float(p) / PA_PER_BAR for p in measured.ambient_pa)
        found.append(Quantity("calibration", "ambient_pressure", ambient, "bar", how))
    if delay.delay_s:
        found.append(Quantity("calibration", "pressure_delay", (delay.delay_s,), "s", delay.source, delay.std_s))
    if mapping.tip is not None and mapping.tip.offset_mm is not None:
        found.append(Quantity("calibration", "tip_offset", mapping.tip.offset_mm, "mm", source))
    if gravity is not None:
        how = f"load cell, {gravity.readings} rows at rest"
        direction = tuple(gravity.direction.tolist())
        found.append(Quantity("calibration", GRAVITY_DIRECTION, direction, "1", how, gravity.std_rad))
    return tuple(found)


def _word(text: str) -> str:
    """Return the name of a file with the characters that a run id may have."""
    return re.sub(r"[^\w-]+", "-", text).strip("-") or "data"
