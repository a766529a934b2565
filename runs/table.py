"""A group of an archive as a table: one-dimensional columns with the unit in their names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runs.archive import layout
from runs.archive.checked import ArchiveContents, opened
from runs.archive.schema import TEXT

Column = NDArray[Any]
TABLES = (
    "pressure",
    "aux",
    "tip",
    "sections",
    "trigger",
    "exposure",
    "adaptation",
    "tip_control",
    "timing",
    "simulator",
    "reference",
    "events",
)
"""Groups whose rows are those of their `time`."""


def table(path: Path | str, group: str) -> dict[str, Column]:
    """Return {name: column (n,)} of a group of `TABLES`, in the order time first; empty where the group is missing.

    A field of several columns becomes one for each actuator, valve or axis: `measured_bar` (N, 3) gives
    `measured_1_bar`, `measured_2_bar` and `measured_3_bar`; `measured_mm` (M, 3) gives `measured_x_mm` and so on.
    Auxiliary inputs have units of their own: `value_load_N`. Measured sections come first: `measured_middle_x_mm`.
    """
    with opened(path) as archive:
        fields = archive.fields(f"entry/{group}")
        if not fields:
            return {}
        columns = {"time_s": archive.value(f"entry/{group}/time")}
        # In the order of their names, as HDF5 lists them.
        for name in sorted(fields):
            scales = fields[name].scales
            if scales[:1] == ("time",) and (len(scales) < 3 or scales[1] == "section"):
                columns.update(_columns(archive, f"entry/{group}", name))
    return columns


def segments(path: Path | str) -> dict[str, Column]:
    """Return {name: column (S,)} of the protocol's segments as they were played; empty where there are none.

    `start_s` and `stop_s` are in protocol time, as `protocol_time_s` of the tables is; levels are those of the end.
    """
    with opened(path) as archive:
        if not len(archive.value("entry/protocol/segment")):
            return {}
        columns: dict[str, Column] = {}
        for name in ("segment", "kind", "label", "start", "stop", "level_bar"):
            columns.update(_columns(archive, "entry/protocol", name))
        return columns


def _columns(archive: ArchiveContents, group: str, name: str) -> dict[str, Column]:
    field = archive.fields(group)[name]
    values = archive.value(f"{group}/{name}")
    if field.kind == TEXT:
        values = np.array(values, dtype=object)
    plain, unit = layout.split_unit(name)
    unit = unit or field.units
    end = f"_{unit}" if unit else ""
    if len(field.dimensions) == 1:
        return {f"{plain}{end}": values}
    labels = archive.value(f"{group}/{field.scales[1]}")
    if len(field.dimensions) == 3:
        inner = archive.value(f"{group}/{field.scales[2]}")
        return {
            f"{plain}_{one}_{other}{end}": np.ascontiguousarray(values[:, i, k])
            for i, one in enumerate(labels)
            for k, other in enumerate(inner)
        }
    ends = [end] * len(labels)
    if (units := f"{field.scales[1]}_unit") in archive.fields(group):
        ends = [f"_{unit}" for unit in archive.value(f"{group}/{units}")]
    return {f"{plain}_{labels[i]}{ends[i]}": np.ascontiguousarray(values[:, i]) for i in range(len(labels))}
