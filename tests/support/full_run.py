"""A journal from which an archive has every group and field that an archive can have."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from runs.journal.journal import JournalWriter
from runs.journal.row_kinds import ROW_KINDS
from runs.records import (
    AuxiliaryChannel,
    Quantity,
    RecordedFile,
    RunFooter,
    SectionPlace,
    Status,
    StudyRole,
    StudyRun,
)
from tests.support import synthetic_runs

ROWS = 4


def write_full_journal(path: Path) -> Path:
    """Write four rows of every kind, whose values are zero, and every other record."""
    plain = synthetic_runs.header(path.stem)
    adapted = (("shear_ratio", 0.4, ""), ("mass", 50.0, "g"))
    header = replace(
        plain,
        cameras=("front", "side"),
        tracker="pose",
        adapted=tuple(Quantity("adaptation", name, (value,), unit, "", 0.1) for name, value, unit in adapted),
        auxiliary=(AuxiliaryChannel("load", "N"), AuxiliaryChannel("room", "degC")),
        valve_units=("V", "bar"),
        tip_controller="horizon",
        learned_from=("earlier", "earliest"),
        streams=True,
        triggered=True,
        sections=(SectionPlace("middle", 85.0),),
        metadata={"specimen": "A7", "email": "-"},
        quantities=(
            *plain.quantities,
            Quantity("protocol", "peak", (0.2,), "bar", ""),
            Quantity("model", "angles", (0.0, 120.0, 240.0), "deg", "rig.yaml"),
        ),
        protocol_files=(RecordedFile.of("a.csv", "csv", "1,2"),),
        calibrations=(RecordedFile.of("c.yaml", "camera", "a: 1"),),
        study=StudyRun("study", StudyRole.RUN, 1, 1, 1, "-", "-"),
    )
    writer = JournalWriter(path, header)
    for kind in ROW_KINDS:
        rows = np.zeros(ROWS, kind.dtype(header))
        rows["t_ns"] = synthetic_runs.START_NS + np.arange(ROWS) * 33_000_000
        if kind.name == "observations":
            rows["tip_motion"] = 1
        getattr(writer, kind.name)(rows)
    for index in range(2):
        writer.picture(synthetic_runs.picture(index))
    writer.event(synthetic_runs.ARMED)
    writer.close(RunFooter(synthetic_runs.START_NS, Status.FINISHED, "", {"missed_deadlines": 0}))
    return path
