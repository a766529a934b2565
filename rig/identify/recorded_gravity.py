"""Directions of gravity that load cells measured, in archives of imported runs."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calibration.identify.errors import NoDataError
from runs.records import RecordedFile
from runs.run import Run

_SIGMAS = 3.0


def gravity_files(run: Run) -> tuple[RecordedFile, ...]:
    """The calibration of a run's rig that states a measured direction of gravity; empty without one."""
    return tuple(file for file in run.header.calibrations if file.kind == "gravity")


def check_gravity(archives: Sequence[Run]) -> tuple[str, ...]:
    """Refuse runs with different measured directions of gravity; return a note on runs without the one that is used.

    Raises:
        NoDataError: two directions are more than three standard uncertainties apart.
    """
    measured = [(run, quantity) for run in archives if (quantity := run.header.measured_gravity) is not None]
    if not measured:
        return ()
    (first, reference), *others = measured
    for run, quantity in others:
        apart = math.acos(min(1.0, float(np.dot(reference.value, quantity.value))))
        if apart > _SIGMAS * (std := math.hypot(reference.uncertainty, quantity.uncertainty)):
            raise NoDataError(
                f"the load cells of {first.path} and {run.path} show directions of gravity that are "
                f"{math.degrees(apart):.1f} degrees apart, {apart / std:.1f} standard uncertainties: "
                "identify them separately"
            )
    if first is not archives[0]:
        return (
            f"{first.header.run_id} has a measured direction of gravity; that of {archives[0].header.run_id}, which "
            "is named first, counts",
        )
    if len(archives) == 1:
        return ()
    return (f"the direction of gravity that {first.header.run_id} measured counts for all runs",)
