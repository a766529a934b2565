"""Replay: run vision and model on a run's stored pictures and pressures; write an archive that names its parent."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from model.units import PA_PER_BAR
from model.variants import VARIANTS
from protocols import arguments
from protocols.problems import bad_input
from rig.config import loader
from rig.config.loader import RigFile
from rig.config.parameters_overlay import read as read_parameters
from rig.config.schema import RigConfig
from rig.config.sections import Variant
from rig.execution.plan import sample_rows
from rig.experiment.provenance import quantities, section_places, software
from rig.hardware.cameras.base import Frame, FrameSet
from rig.observation.observer import MeasuredTipForce, Observer
from runs.archive.column_groups import clock_ns
from runs.archive.writer import ArchiveError, finalise
from runs.data_folder import DATA, free_id
from runs.journal.journal import SUFFIX, JournalWriter
from runs.journal.row_kinds import ROW_KINDS
from runs.records import RunFooter, blank
from runs.run import Run


def replay(
    run: Run,
    folder: Path | str = DATA,
    rig: str | None = None,
    variant: Variant | None = None,
    parameters: Path | None = None,
    calibrations: Sequence[Path] = (),
) -> Path:
    """Process a run's pictures again and return the new archive's path.

    `rig` is a name or file with other calibration, model or material; by default the run's own. `parameters` is a file
    of identified parameters, `calibrations` are files of `rig calibrate`. The model treats frames that were not stored
    as dropped frames.

    Raises:
        ArchiveError: the run has no pictures.
        BadInputError: the rig is invalid, has another number of actuators, or measures another tip force than the run.
    """
    arguments.of_type("RUN", run, Run, "an archive, as runs.open(..)")
    if not len(run.frames.index):
        raise ArchiveError(f"{run.path} holds no pictures: there is nothing to replay")
    rig_file, chosen = replay_rig(run, rig, variant, parameters, calibrations)
    # The frames have their times in the archive, and a replay gives no pulses.
    config = rig_file.config.free_running
    if not config.cameras:
        expected = "a rig with a camera: this one has none to measure the tip in the run's pictures"
        raise bad_input("--rig", config.name, expected)
    rows = np.array(list(_observed(run, config, chosen)))
    now = datetime.now(UTC)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    header = replace(
        run.header,
        run_id=free_id(folder, f"{run.header.run_id}-replay"),
        parent=run.header.run_id,
        notes="; ".join(filter(None, (run.header.notes, f"replayed {now:%Y-%m-%d %H:%M} UTC"))),
        rig_name=config.name,
        rig_yaml=rig_file.text,
        calibrations=rig_file.calibrations,
        parameters_yaml=rig_file.parameters,
        model_variant=chosen,
        cameras=tuple(config.cameras),
        sections=section_places(config),
        triggered=False,
        **software(),
        quantities=(*run.header.protocol_parameters, *quantities(config)),
        adapted=(),
    )
    journal = JournalWriter(folder / f"{header.run_id}{SUFFIX}", header)
    for kind in ROW_KINDS:
        if kind.recorded(header):
            getattr(journal, kind.name)(rows if kind.name == "observations" else run.rows(kind))
    for event in run.events:
        journal.event(event)
    journal.close(RunFooter(int(rows["t_ns"][-1]), run.status, run.message, run.timing.counters))
    return finalise(journal.path)


def replay_rig(
    run: Run,
    rig: str | None = None,
    variant: Variant | None = None,
    parameters: Path | None = None,
    calibrations: Sequence[Path] = (),
) -> tuple[RigFile, Variant]:
    """Return the rig and the model variant of a replay; see `replay`.

    Raises:
        BadInputError: the rig is invalid, or has another number of actuators.
    """
    found = loader.recorded(run.header, run.path) if rig is None else loader.read(rig)
    chosen = variant or (_variant(run) if rig is None else found.config.model.variant)
    if calibrations or parameters is not None:
        laid = None if parameters is None else read_parameters(parameters)
        found = found.overlaid(loader.read_calibrations(calibrations), laid, None if laid is None else chosen)
    if found.config.actuators != run.header.actuators:
        expected = f"a rig with {run.header.actuators} actuators, as the run had"
        value = f"{found.config.name}, which has {found.config.actuators}"
        raise bad_input("--rig", value, expected)
    return found, chosen


def _variant(run: Run) -> Variant:
    name = run.header.model_variant
    if name not in VARIANTS:
        raise ArchiveError(f"{run.path}: entry/model/variant: found {name!r}, expected one of {', '.join(VARIANTS)}")
    return name


def _picture(run: Run, k: int) -> NDArray[np.uint8]:
    data = np.frombuffer(run.picture(k), np.uint8)
    # OpenCV raises for an empty buffer and returns None for an invalid picture.
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if len(data) else None
    if image is None:
        raise ArchiveError(f"{run.path}: entry/frames/image[{k}]: found {len(data)} bytes, expected a JPEG or PNG")
    return np.asarray(image, np.uint8)


def _observed(run: Run, config: RigConfig, variant: Variant) -> Iterator[NDArray[np.void]]:
    """Yield the observations of the stored frames in order.

    With the reference and the learned disturbance of the tip that the run had.
    """
    observer = Observer(config, variant)
    tip, given = run.tip, [table for table in (run.reference, run.learning) if table is not None]
    clock = run.header.started_t_ns
    samples = blank(len(run.pressure.time_s), sample_rows(config))
    samples["t_ns"] = clock_ns(run.pressure.time_s, clock)
    samples["measured_pa"] = run.pressure.measured_bar * PA_PER_BAR
    aux = _auxiliary(run, config)
    if config.inputs:
        samples["aux"] = aux
    truth_mm = run.simulated.tip_mm if run.simulated is not None else np.full((len(tip.frame), 3), np.nan)
    row_of = {int(frame): row for row, frame in enumerate(tip.frame)}
    camera_of = _cameras(run, config)
    pictures: dict[int, list[int]] = {}
    for k, (index, name) in enumerate(zip(run.frames.index, run.frames.camera, strict=True)):
        if int(index) in row_of and name in camera_of:
            pictures.setdefault(int(index), []).append(k)
    seen = 0
    before = None
    for index, picture_indices in pictures.items():
        row = row_of[index]
        frames: list[Frame | None] = [None] * len(config.cameras)
        for k in picture_indices:
            t_ns = int(clock_ns(run.frames.time_s[k], clock))
            truth_m = truth_mm[row] * 1e-3
            frames[camera_of[run.frames.camera[k]]] = Frame(index, t_ns, _picture(run, k), truth_m)
        frame_set = FrameSet(index, tuple(frames))
        until = min(int(np.searchsorted(samples["t_ns"], frame_set.t_ns, side="left")) + 1, len(samples))
        dropped = 0 if before is None else index - before - 1
        before = index
        weight_kg = float(tip.weight_g[row]) * 1e-3
        found = observer.step(frame_set, samples[seen:until], float(tip.protocol_s[row]), dropped, weight_kg)
        seen = until
        for table in given:
            table.set_fields(found, row)
        yield found


def _auxiliary(run: Run, config: RigConfig) -> NDArray[np.float64]:
    """Return the run's auxiliary inputs (n, I) in the order of the rig's; NaN for one that the run did not have.

    Raises:
        BadInputError: the rig measures another tip force than the run.
    """
    recorded = [channel.name for channel in run.header.auxiliary]
    used = MeasuredTipForce(config).inputs
    missing = next((name for name in used if name not in recorded), None)
    if missing is not None:
        expected = f"a rig whose tip force the run has measured: {run.header.run_id} has no input {missing}"
        raise bad_input("--rig", config.name, expected)
    measured = MeasuredTipForce(loader.recorded(run.header, run.path).config).inputs
    if lost := [name for name in measured if name not in used]:
        expected = f"a rig whose input {lost[0]} has a tip_force_direction, as in the run"
        raise bad_input("--rig", config.name, expected)
    aux = np.full((len(run.pressure.time_s), len(config.inputs)), np.nan)
    for k, name in enumerate(config.inputs):
        if run.auxiliary is not None and name in recorded:
            aux[:, k] = run.auxiliary.value[:, recorded.index(name)]
    return aux


def _cameras(run: Run, config: RigConfig) -> dict[str, int]:
    """Map the run's cameras to the rig's: by name, or by order where no name matches."""
    names = list(config.cameras)
    if set(names).isdisjoint(run.header.cameras):
        return dict(zip(run.header.cameras, range(len(names)), strict=False))
    return {name: names.index(name) for name in run.header.cameras if name in names}
