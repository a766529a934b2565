"""Which model of motion runs beside a rig, or alone."""

from __future__ import annotations

from dataclasses import replace

from model import Arm
from model.dynamics import Dynamics


def motion_model(arm: Arm, dt_s: float, static: bool) -> Dynamics | None:
    """Return the stepper of an arm [s]; None where each prediction is a static solution.

    A static arm that remembers moves without inertia.
    """
    if not static:
        return Dynamics(arm, dt_s)
    return Dynamics(replace(arm, inertia=False), dt_s) if arm.remembers else None
