"""The recursive estimator beside the observer: each measured tip corrects the model's parameters a little."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

import model
from calibration.identify.parameters import Prior, Setup
from calibration.identify.recursive_estimator import RecursiveEstimator
from rig.config.arm_model import TipLoad, model_arm
from rig.config.schema import PA_PER_BAR, RigConfig, Variant
from runs.records import Quantity, adaptation_dtype

USUAL = ("law", "rpe_per_bar", "base", "sensor_offsets")
USUAL_HOMOGENEOUS = ("youngs_modulus_pa", "rpe_per_bar", "base", "sensor_offsets")


def usual(variant: Variant) -> tuple[str, ...]:
    """What is estimated where nothing else is said; `rig identify` frees it, too."""
    return USUAL_HOMOGENEOUS if variant.startswith("homogeneous") else USUAL


def adapter(config: RigConfig, variant: Variant | None, parameters: Sequence[str]) -> RecursiveEstimator:
    """The estimator of a rig's arm, begun at the rig's own numbers; half a sensor's accuracy is what its zero may be.

    Raises:
        UnknownParameter, NotAdaptable: a parameter is none, or cannot be estimated frame by frame.
    """
    zeros = {
        f"sensor_{sensor.actuator}_offset_pa": Prior(0.0, sensor.accuracy_bar * PA_PER_BAR / 2)
        for sensor in config.sensors
    }
    return RecursiveEstimator(Setup(model_arm(config, variant)), parameters, zeros)


def adapted(config: RigConfig, variant: Variant | None, parameters: Sequence[str]) -> tuple[Quantity, ...]:
    """What will be estimated: names, units, starting values and how well they are known. Raises as `adapter` does."""
    begun = adapter(config, variant, parameters)
    columns = zip(begun.names, begun.values, begun.units, begun.std, strict=True)
    return tuple(
        Quantity("adaptation", name, (float(value),), unit, f"rig {config.name}", float(std))
        for name, value, unit, std in columns
    )


class OnlineEstimation:
    """Follows the observer frame by frame. Knows no clock, and nothing of it reaches the valves."""

    def __init__(self, config: RigConfig, variant: Variant | None, parameters: Sequence[str]) -> None:
        self._adapter = adapter(config, variant, parameters)
        self._arm = model_arm(config, variant)
        self._hook = TipLoad(config)
        self._row = np.zeros((), adaptation_dtype(len(self._adapter.names)))
        self._predicted_m = np.full(3, np.nan)

    def step(self, seen: NDArray[np.void]) -> NDArray[np.void]:
        """Use one row of observations (); return the row of `runs.records.adaptation_dtype` to it.

        The model's tip in `seen` becomes that of the estimates before this frame. What motion adds to the tip is taken
        from the running model, whose parameters stay as they are.
        """
        row = self._row.copy()
        row["t_ns"], row["frame"], row["start_model_m"] = seen["t_ns"], seen["frame"], seen["model_m"]
        done = self._adapter.step(
            seen["pressure_pa"],
            seen["measured_m"],
            seen["covariance_m2"],
            self._motion_m(seen),
            float(seen["weight_kg"]),
        )
        solved = bool(np.isfinite(done.predicted_m).all())
        if solved:
            self._predicted_m = done.predicted_m
        seen["model_m"], seen["model_ok"] = self._predicted_m, solved
        row["used"] = int(done.used) + int(done.damped)
        row["value"], row["covariance"] = self._adapter.values, self._adapter.covariance
        return row

    def _motion_m(self, seen: NDArray[np.void]) -> NDArray[np.float64]:
        """By how much the running model's tip differs from its own at rest; NaN where it has none."""
        nothing = np.full(3, np.nan)
        if not seen["model_ok"]:
            return nothing
        try:
            rest = self._arm.statics(
                seen["pressure_pa"], self._hook.carrying(float(seen["weight_kg"])), doubt_units=False
            )
        except (model.NotConverged, ValueError):
            return nothing
        moved: NDArray[np.float64] = seen["model_m"] - rest.tip_m
        return moved
