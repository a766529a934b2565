"""What a tip path asks of a rig: speed, margins to the limits, and the error to expect from uncertain parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.identify.unknowns.memory_parameters import ALL_NAMES
from calibration.identify.unknowns.parameters import groups
from calibration.identify.unknowns.segments import known_of, number_of
from calibration.identify.unknowns.setup import Setup
from model import batch, sensitivities
from model.arrays import Array
from model.units import PA_PER_BAR
from model.variation import GRADIENT_STEP_PA, Variation
from protocols import SetPointTrajectory, TipMotion
from rig.config.arm_model import model_arm
from rig.config.schema import RigConfig
from rig.config.sections import Variant
from rig.tip_planning.path_follower import drive_of

POSTURES = 12
"""Points of the path at which uncertainties are propagated."""
NAMED = 3
"""Parameters that are named as the largest causes."""
NOT_OF_THE_ARM = ("base_", "tool_", "sensor_lag", "sensor_filter")
"""Parameters of the measurement: they do not move the tip in the rod-base frame."""


@dataclass(frozen=True)
class PathAssessment:
    """One tip path, without its lead-in; errors are root mean squares over the path."""

    label: str
    line: int
    fastest_mm_s: float
    model_error_mm: float
    """Of the model under the set-points."""
    low_margin_bar: float
    """Lowest set-point: distance from 0 bar."""
    high_margin_bar: float
    rate_margin_bar_s: float
    expected_error_mm: float
    """Standard deviation of the tip without feedback, from the standard uncertainties of the parameters."""
    pressure_std_bar: float
    """Standard deviation of the pressures that another arm needs for the same path; compare it with the margins."""
    causes: tuple[tuple[str, float], ...]
    """Parameters with the largest shares of the expected error [mm]."""


def assess(config: RigConfig, trajectory: SetPointTrajectory, variant: Variant | None = None) -> list[PathAssessment]:
    """Assess every tip path of a trajectory; uncertainties are those of the rig file, or of the parameter's kind."""
    return [_assess(config, trajectory, motion, variant) for motion in trajectory.tip.motions]


def _assess(
    config: RigConfig, trajectory: SetPointTrajectory, motion: TipMotion, variant: Variant | None
) -> PathAssessment:
    on_path = motion.times_s >= motion.path_s
    times = motion.times_s[on_path]
    axes = list(motion.coordinates)
    off = (motion.predicted_m - motion.position_m)[on_path][:, axes]
    speed = np.linalg.norm(motion.velocity_m_s[on_path][:, axes], axis=1)
    pressure = trajectory.sample(times)
    # A path of one time has no rate of its own.
    rates = trajectory.rates_pa_s(times[: max(1, len(times) - 1)])
    some = pressure[np.linspace(0, len(pressure) - 1, POSTURES).astype(int)]
    shares, needed = _propagated(config, some, axes, trajectory.weight_kg(motion.path_s), variant)
    order = sorted(shares, key=shares.__getitem__, reverse=True)
    limits = config.limits
    return PathAssessment(
        label=motion.label,
        line=motion.line,
        fastest_mm_s=float(1e3 * speed.max()),
        model_error_mm=float(1e3 * np.sqrt(np.mean((off**2).sum(axis=1)))),
        low_margin_bar=float(pressure.min()) / PA_PER_BAR,
        high_margin_bar=limits.pressure_bar - float(pressure.max()) / PA_PER_BAR,
        rate_margin_bar_s=limits.rate_bar_per_s - float(np.abs(rates).max()) / PA_PER_BAR,
        expected_error_mm=float(1e3 * np.sqrt(sum(share**2 for share in shares.values()))),
        pressure_std_bar=needed / PA_PER_BAR,
        causes=tuple((name, 1e3 * shares[name]) for name in order[:NAMED]),
    )


def _propagated(
    config: RigConfig, pressure: Array, axes: list[int], weight_kg: float, variant: Variant | None
) -> tuple[dict[str, float], float]:
    """Tip error [m] by parameter, and the standard deviation [Pa] of the pressures that make up for all of them.

    First order: each parameter is changed by its standard uncertainty, at rest under pressure (K, N).
    """
    arm = model_arm(config, variant)
    start = Setup(arm)
    stated = _by_parameter(config, arm.actuators)
    reference = batch.statics(arm, pressure).tip_m
    drive = drive_of(config)
    changes = [Variation(GRADIENT_STEP_PA, arm, pressure + GRADIENT_STEP_PA * c) for c in drive.matrix().T]
    weights = np.full(len(pressure), weight_kg) if weight_kg else None
    gradient = sensitivities.statics(arm, pressure, changes, weights).tip_by[:, axes]
    shares: dict[str, float] = {}
    needed = np.zeros((len(pressure), drive.valves))
    for name, parameter in known_of(arm).items():
        # At rest nothing is remembered.
        if name.startswith(NOT_OF_THE_ARM) or number_of(name) in ALL_NAMES:
            continue
        std = stated.get(number_of(name), parameter.uncertainty(parameter.read(start)))
        changed = parameter.write(start, parameter.read(start) + std)
        tips = batch.statics(changed.turned_arm, changed.pressure_pa(pressure)).tip_m
        shift = np.nan_to_num(tips - reference)[:, axes]
        shares[name] = float(np.sqrt(np.mean((shift**2).sum(axis=1))))
        needed += np.einsum("kvc,kc->kv", np.linalg.pinv(gradient), shift) ** 2
    return shares, float(np.sqrt(needed.max()))


def _by_parameter(config: RigConfig, actuators: int) -> dict[str, float]:
    """The stated standard uncertainties by parameter; one of a group holds for each of its parameters."""
    several = groups(actuators)
    stated = config.uncertainties.stated()
    return {one: std for name, std in stated.items() for one in several.get(name, (name,))}
