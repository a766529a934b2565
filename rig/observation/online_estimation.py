"""Online estimation: the recursive estimator updates the model's parameters with each measured frame."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

import model
from calibration.identify.recursive_estimator import RecursiveEstimator, SectionMeasurements
from calibration.identify.unknowns.parameter import Prior
from calibration.identify.unknowns.parameters import PUSH_GROWTH
from calibration.identify.unknowns.section_mounts import offset_names, rotation_names
from calibration.identify.unknowns.setup import Setup
from model.statics import statics
from model.units import PA_PER_BAR
from model.variants import variant_named
from rig.config.arm_model import TipLoad, model_arm
from rig.config.schema import RigConfig
from rig.config.sections import Variant
from runs.records import DetectionStatus, Quantity, adaptation_dtype, blank


def default_parameters(config: RigConfig, variant: Variant | None = None) -> tuple[str, ...]:
    """Return the default free parameters, also those of `rig identify`; `variant` overrides the rig's."""
    law = variant_named(variant or config.model.variant).law
    growth = (PUSH_GROWTH,) if config.arm.actuation.as_law().grows else ()
    return (*law.parameters, "rpe_per_bar", "base", "sensor_offsets", *growth)


def recursive_estimator(config: RigConfig, variant: Variant | None, parameters: Sequence[str]) -> RecursiveEstimator:
    """Return the estimator of a rig's arm with the rig's values as initial estimates; it uses the measured sections.

    The prior of a sensor's offset has half its accuracy as standard deviation.

    Raises:
        UnknownParameter, NotEstimableError: a name is unknown, or cannot be estimated recursively.
    """
    zeros = {
        f"sensor_{sensor.actuator}_offset_pa": Prior(0.0, sensor.accuracy_bar * PA_PER_BAR / 2)
        for sensor in config.sensors
    }
    start = Setup(model_arm(config, variant))
    return RecursiveEstimator(start, parameters, zeros | section_priors(config), sections_m=section_lengths_m(config))


def section_lengths_m(config: RigConfig) -> dict[str, float]:
    """Arc lengths [m] of the measured sections from the rod base, by name."""
    return {name: section.at_mm * 1e-3 for name, section in config.sections.items()}


def section_priors(config: RigConfig) -> dict[str, Prior]:
    """Priors of the boards of the measured sections, where the rig states how well they are placed."""
    found: dict[str, Prior] = {}
    for name, section in config.sections.items():
        placed = section.board.placement
        if placed.translation_std_mm:
            found |= dict.fromkeys(offset_names(name), Prior(0.0, placed.translation_std_mm * 1e-3))
        if placed.rotation_std_deg:
            found |= dict.fromkeys(rotation_names(name), Prior(0.0, math.radians(placed.rotation_std_deg)))
    return found


def estimated_quantities(config: RigConfig, variant: Variant | None, parameters: Sequence[str]) -> tuple[Quantity, ...]:
    """Return names, units, initial values and standard deviations; raises as `recursive_estimator` does."""
    estimator = recursive_estimator(config, variant, parameters)
    columns = zip(estimator.names, estimator.values, estimator.units, estimator.std, strict=True)
    return tuple(
        Quantity("adaptation", name, (float(value),), unit, f"rig {config.name}", float(std))
        for name, value, unit, std in columns
    )


class OnlineEstimation:
    """Updates the estimates frame by frame. It uses no clock and is not part of the control loop."""

    def __init__(self, config: RigConfig, variant: Variant | None, parameters: Sequence[str]) -> None:
        self._estimator = recursive_estimator(config, variant, parameters)
        self._arm = model_arm(config, variant)
        self._tip_load = TipLoad(config)
        self._sections_m = np.array(list(section_lengths_m(config).values()))
        self._row = blank((), adaptation_dtype(len(self._estimator.names)))
        self._predicted_m = np.full(3, np.nan)

    def step(self, observation: NDArray[np.void]) -> NDArray[np.void]:
        """Update with one observation (); return a row of `runs.records.adaptation_dtype`.

        The model's tip and sections in `observation` are replaced by the predictions with the prior estimates. Their
        dynamic part comes from the running model, whose parameters are constant.
        """
        row = self._row.copy()
        row["t_ns"], row["frame"], row["start_model_m"] = (
            observation["t_ns"],
            observation["frame"],
            observation["model_m"],
        )
        motion_m = self._motion_m(observation)
        update = self._estimator.step(
            observation["pressure_pa"],
            observation["measured_m"],
            observation["covariance_m2"],
            motion_m[0],
            float(observation["weight_kg"]),
            self._sections(observation, motion_m[1:]),
        )
        solved = bool(np.isfinite(update.predicted_m).all())
        if solved:
            self._predicted_m = update.predicted_m
        observation["model_m"], observation["model_ok"] = self._predicted_m, solved
        if len(self._sections_m):
            observation["section_model_m"] = update.sections_m
        row["used"] = int(update.used) + int(update.damped)
        row["value"], row["covariance"] = self._estimator.values, self._estimator.covariance
        return row

    def _sections(self, observation: NDArray[np.void], motion_m: NDArray[np.float64]) -> SectionMeasurements | None:
        """The measured sections of an observation (), with their motion (S, 3)."""
        if not len(motion_m):
            return None
        seen = observation["section_seen"] == DetectionStatus.MEASURED
        point_m = np.where(seen[:, None], observation["section_m"], np.nan)
        return SectionMeasurements(point_m, observation["section_covariance_m2"], motion_m)

    def _motion_m(self, observation: NDArray[np.void]) -> NDArray[np.float64]:
        """Return tip and sections (1 + S, 3) of the running model minus its static ones; NaN without a solution."""
        nothing = np.full((1 + len(self._sections_m), 3), np.nan)
        if not observation["model_ok"]:
            return nothing
        try:
            rest = statics(
                self._arm,
                observation["pressure_pa"],
                self._tip_load.carrying(float(observation["weight_kg"])),
                doubt_units=False,
            )
        except (model.NotConverged, ValueError):
            return nothing
        moved: NDArray[np.float64] = (observation["model_m"] - rest.tip_m)[None]
        if len(self._sections_m):
            along = observation["section_model_m"] - rest.frames_at(self._sections_m)[0]
            moved = np.concatenate([moved, along])
        return moved
