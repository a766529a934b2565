"""A group of an archive as a table: one-dimensional columns with the unit in their names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from runs.archive import layout

Column = NDArray[Any]
TABLES = ("pressure", "tip", "adaptation", "timing", "simulator", "events")
"""Groups whose rows are those of their `time`."""


def table(path: Path | str, group: str) -> dict[str, Column]:
    """Return {name: column (n,)} of a group of `TABLES`, in the order time first; empty where the group is missing.

    A field of several columns becomes one for each actuator, valve or axis: `measured_bar` (N, 3) gives
    `measured_1_bar`, `measured_2_bar` and `measured_3_bar`; `measured_mm` (M, 3) gives `measured_x_mm` and so on.
    """
    with h5py.File(path, "r") as file:
        node = file.get(f"entry/{group}")
        if node is None:
            return {}
        rows = node["time"].shape
        columns = {"time_s": node["time"][()]}
        for name, data in node.items():
            if isinstance(data, h5py.Dataset) and data.shape[:1] == rows and data.ndim < 3 and _along_time(data):
                columns.update(_columns(name, data))
    return columns


def segments(path: Path | str) -> dict[str, Column]:
    """Return {name: column (S,)} of the protocol's segments as they were played; empty where there are none.

    `start_s` and `stop_s` are in protocol time, as `protocol_time_s` of the tables is; levels are those of the end.
    """
    with h5py.File(path, "r") as file:
        node = file.get("entry/protocol")
        if node is None or "segment" not in node or not len(node["segment"]):
            return {}
        columns: dict[str, Column] = {}
        for name in ("segment", "kind", "label", "start", "stop", "level_bar"):
            columns.update(_columns(name, node[name]))
        return columns


def _along_time(data: h5py.Dataset) -> bool:
    return not data.is_scale and data.dims[0][0].name.endswith("/time")


def _columns(name: str, data: h5py.Dataset) -> dict[str, Column]:
    values = data.asstr()[()] if h5py.check_string_dtype(data.dtype) else data[()]
    plain, unit = layout.split_unit(name)
    unit = unit or str(data.attrs.get("units", ""))
    end = f"_{unit}" if unit else ""
    if values.ndim == 1:
        return {f"{plain}{end}": values}
    labels = data.dims[1][0]
    names = labels.asstr()[()] if h5py.check_string_dtype(labels.dtype) else labels[()]
    return {f"{plain}_{label}{end}": np.ascontiguousarray(values[:, i]) for i, label in enumerate(names)}
