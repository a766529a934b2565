"""Rows of control cycles for an observer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from runs.records import sample_dtype


def control_cycles(t_ns: Any, pressure_pa: Any, aux: Sequence[float] = ()) -> np.ndarray:  # type: ignore[type-arg]
    """Control cycles (k,) at times (k,) with pressures (k, N), all with the same values of auxiliary inputs."""
    pressure_pa = np.asarray(pressure_pa, np.float64)
    rows = np.zeros(len(pressure_pa), sample_dtype(pressure_pa.shape[1], 1, len(aux)))
    rows["t_ns"], rows["measured_pa"] = t_ns, pressure_pa
    if aux:
        rows["aux"] = aux
    return rows
