"""Columns of a run that follows a tip path: reference, learned disturbance and the plans of the tip controller."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from runs.columns.conversions import (
    MM_PER_M,
    from_bar,
    from_mm,
    from_us,
    time_column,
    to_bar,
    to_mm,
    to_us,
)
from runs.columns.declaration import Column, Table, Values

PLAN_AHEAD_S = (0.0, 0.1, 0.2, 0.3)
"""Times after the start of a plan at which its set-points are recorded."""
FOLLOWED_S = PLAN_AHEAD_S[-1]
"""For how long after its start a plan is followed; without a newer one the tip is without feedback from then on."""


class SolveStatus(IntEnum):
    """How the tip controller found a plan, or why the control loop refuses it: it then follows the plan before."""

    SOLVED = 0
    NOT_SOLVED = 1
    """The solver failed: the plan continues the one before."""
    REFUSED = 2
    """Refused; the archive does not say why."""
    MALFORMED = 3
    """It is empty, or its times do not ascend."""
    NOT_FINITE = 4
    OUT_OF_LIMITS = 5
    """Outside the pressure limit of the rig."""
    LATE = 6
    """It starts too long before the cycle that took it."""
    EARLY = 7
    """It starts too long after that cycle."""
    OUTDATED = 8
    """It starts before the plan that is followed."""
    NO_PATH = 9
    """The tip has no reference any more."""

    @property
    def refused(self) -> bool:
        """True if the control loop refuses the plan."""
        return self >= SolveStatus.REFUSED

    @property
    def at_fault(self) -> bool:
        """True if the controller has made a plan that could not be followed at any time."""
        return self.refused and self not in {SolveStatus.LATE, SolveStatus.NO_PATH}

    @property
    def words(self) -> str:
        """The status in a message."""
        return self.name.lower().replace("_", " ")


def reference_error_mm(rows: NDArray[np.void]) -> Values:
    """Distance of the measured tip from the reference in the controlled coordinates; NaN where either is unknown."""
    off = (rows["measured_m"] - rows["reference_m"]) * MM_PER_M
    known = np.isfinite(rows["reference_m"]).any(axis=1) & np.isfinite(rows["measured_m"]).all(axis=1)
    return np.where(known, np.sqrt(np.nansum(off**2, axis=1)), np.nan)


class Reference(Table):
    """Where the tip has to be (m, 3), at the times of `Tip`; NaN outside tip paths and in free coordinates."""

    group, rows, signal = "reference", "M", "error_mm"
    about = "one row per camera frame; NaN outside tip paths, and in coordinates that are not controlled"

    time_s = time_column("middle of the exposure")
    reference_mm = Column(
        "reference_m",
        axes=("axis",),
        unit="mm",
        about="reference of the tool centre point",
        convert=to_mm,
        inverse=from_mm,
    )
    predicted_mm = Column(
        "predicted_m",
        axes=("axis",),
        unit="mm",
        about="tool centre point of the model under the feed-forward set-points, computed before the run",
        convert=to_mm,
        inverse=from_mm,
    )
    motion = Column("tip_motion", "<i4", about="number of the protocol's tip path, from 1; 0 outside")
    period = Column(
        "tip_period",
        "<i4",
        about="number of the path's period, from 1; 0 outside and in the lead-in; 1 without periods",
    )
    error_mm = Column(
        of=reference_error_mm, unit="mm", about="distance between measured tip and reference, controlled coordinates"
    )


class Learning(Table):
    """What a run was given of earlier runs (m, 3), at the times of `Tip`. Only for runs that learn."""

    group, rows, signal = "learning", "M", "disturbance_mm"
    about = "iterative learning: what earlier runs have shown of the arm beyond the controller's model"
    facts = (("learned_from", "run"),)
    learned_from: tuple[str, ...]
    """Ids of the earlier runs."""

    time_s = time_column("middle of the exposure")
    disturbance_mm = Column(
        "learned_m",
        axes=("axis",),
        unit="mm",
        about="learned difference between the tip and that of the controller's model; NaN outside tip paths",
        convert=to_mm,
        inverse=from_mm,
    )


class TipControl(Table):
    """What the tip controller found from each frame (m,), and its plan. Only for runs with a tip controller."""

    group, rows, signal = "tip_control", "M", "predicted_mm"
    about = "one row per plan of the tip controller"

    time_s = time_column("middle of the exposure of the frame that led to the plan")
    frame = Column("frame", "<i8", about="as in /entry/tip")
    start_s = Column("start_s", unit="s", about="protocol time from which the plan is followed")
    late_ms = Column(
        "late_s",
        unit="ms",
        about="from start_s to when the control loop took the plan; 0 in virtual time",
        convert=lambda s: s * 1e3,
        inverse=lambda ms: ms / 1e3,
    )
    status = Column(
        "status",
        "<i4",
        about=f"{', '.join(f'{s.value} {s.name.lower()}' for s in SolveStatus)}; from 2 on the plan is refused",
        among=tuple(SolveStatus),
    )
    iterations = Column("iterations", "<i4", about="iterations of the solver")
    active = Column("active", "<i4", about="active constraints of the solver")
    solve_us = Column(
        "solve_ns",
        "<i8",
        unit="us",
        about="time of the step; 0 in virtual time, which repeats bit for bit",
        convert=to_us,
        inverse=from_us,
    )
    plan_bar = Column(
        "plan_pa",
        axes=("ahead", "valve"),
        unit="bar",
        about="set-points of the plan at these times after its start; NaN beyond its end",
        convert=to_bar,
        inverse=from_bar,
    )
    predicted_mm = Column(
        "predicted_m",
        axes=("axis",),
        unit="mm",
        about="tip that the controller expects at the start of the plan; NaN without a prediction",
        convert=to_mm,
        inverse=from_mm,
    )
    nis = Column("nis", about="normalised innovation squared of the frame; 3 on average if the estimator is consistent")
