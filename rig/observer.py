"""Per frame: picture -> measured tip, measured pressures -> modelled tip, side by side in one row."""

from __future__ import annotations

from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

import model
from rig.arm import Hook, model_arm
from rig.cameras.base import Frame
from rig.config import RigConfig, Variant
from rig.eye import Eye, Measurement
from rig.sketch import backbone
from runs.records import Seen, observation_dtype

Floats = NDArray[np.float64]
Times = NDArray[np.int64]

# Catching up on more lost frames than this costs more time than it is worth: the model starts anew at rest.
_MOST_STEPS = 10
_HISTORY_NS = 1_000_000_000
_GLIMPSE_ROWS = 16
"""Every so many rows of a picture are compared with the last one's: a sensor's noise never repeats."""
_NOTHING_NEW = Measurement(Seen.NO_FRAME, np.full(3, np.nan), np.full((3, 3), np.nan), float("nan"), None)


class _Companion(Protocol):
    """The model in one of its modes."""

    def follow(self, frame: Frame, pressures: Pressures, loads: model.Loads | None) -> model.Shape | None:
        """Shape of the arm at the frame's time; None where it cannot be solved."""


class Pressures:
    """The measured pressures of the last second, interpolated."""

    def __init__(self, actuators: int) -> None:
        self._t_ns: Times = np.empty(0, np.int64)
        self._pa: Floats = np.empty((0, actuators))

    def extend(self, t_ns: Times, pa: Floats) -> None:
        """Append samples `t_ns` (k,), `pa` (k, N); such as are not newer than the last known are ignored."""
        if self._t_ns.size:
            new = t_ns > self._t_ns[-1]
            t_ns, pa = t_ns[new], pa[new]
        if t_ns.size:
            keep = self._t_ns > t_ns[-1] - _HISTORY_NS
            self._t_ns = np.concatenate([self._t_ns[keep], t_ns])
            self._pa = np.concatenate([self._pa[keep], pa])

    def at(self, t_ns: int) -> Floats:
        """Pressures (N,) [Pa] at a time, the nearest sample beyond the ends; NaN when nothing was measured yet."""
        if not self._t_ns.size:
            return np.full(self._pa.shape[1], np.nan)
        # Relative times: nanoseconds since boot do not fit a float exactly.
        elapsed = (self._t_ns - self._t_ns[0]).astype(np.float64)
        return np.array([np.interp(float(t_ns - self._t_ns[0]), elapsed, column) for column in self._pa.T])


class _AtRest:
    """Statics at every frame."""

    def __init__(self, arm: model.Arm) -> None:
        self._arm = arm

    def follow(self, frame: Frame, pressures: Pressures, loads: model.Loads | None) -> model.Shape | None:
        return _rest(self._arm.statics, pressures.at(frame.t_ns), loads)


class _InMotion:
    """Dynamics in steps of the camera's period: as many as periods have passed since the last frame."""

    def __init__(self, arm: model.Arm, period_s: float) -> None:
        self._dynamics = arm.dynamics(period_s)
        self._last: Frame | None = None

    def follow(self, frame: Frame, pressures: Pressures, loads: model.Loads | None) -> model.Shape | None:
        last, self._last = self._last, None
        steps = frame.index - last.index if last is not None else 0
        if last is None or not 0 < steps <= _MOST_STEPS:
            shape = _rest(self._dynamics.start, pressures.at(frame.t_ns), loads)
        else:
            shape = None
            for k in range(1, steps + 1):
                pressure = pressures.at(last.t_ns + (frame.t_ns - last.t_ns) * k // steps)
                shape = self._dynamics.step(pressure, loads) if np.all(np.isfinite(pressure)) else None
                if shape is None or not shape.ok:
                    # The next frame starts anew at rest: a history with a hole is no history.
                    return None
        if shape is not None:
            self._last = frame
        return shape


def _rest(solve: _Solve, pressure: Floats, loads: model.Loads | None) -> model.Shape | None:
    if not np.all(np.isfinite(pressure)):
        return None
    try:
        shape = solve(pressure, loads)
    except model.NotConverged:
        return None
    return shape if shape.ok else None


class _Solve(Protocol):
    def __call__(self, pressure_pa: Floats, loads: model.Loads | None, /) -> model.Shape: ...


class Observer:
    """Turns frames, in their order, into rows of `runs.records.observation_dtype`. Knows no clock."""

    def __init__(self, config: RigConfig, variant: Variant | None = None, camera: str | None = None) -> None:
        """`variant` of the model (the rig's when None), `camera` by name (the first when None)."""
        # The pictures are small: a second thread gains nothing here and costs the control process its core.
        cv2.setNumThreads(1)
        name = camera if camera is not None else next(iter(config.cameras))
        self._eye = Eye(config, name)
        arm = model_arm(config, variant)
        self._model: _Companion = (
            _AtRest(arm) if config.model.mode == "static" else _InMotion(arm, 1 / config.cameras[name].rate_hz)
        )
        self._hook = Hook(config)
        self._pressures = Pressures(config.actuators)
        self._dtype = observation_dtype(config.actuators)
        self._model_m = np.full(3, np.nan)
        self._glimpse: NDArray[np.uint8] | None = None
        self.measurement: Measurement | None = None
        """Of the last frame, as `shape` is the model's; for those who draw them."""
        self.shape: model.Shape | None = None

    def step(
        self,
        frame: Frame,
        sample_t_ns: Times,
        sample_pa: Floats,
        protocol_s: float,
        dropped: int = 0,
        weight_kg: float = 0.0,
    ) -> NDArray[np.void]:
        """Observe one frame with the samples (k,), (k, N) that came since the last; return a row, shape ().

        `weight_kg` is what the operator has hung on the end cap.

        `age_ns` is left at zero for whoever has a clock.
        """
        self._pressures.extend(np.asarray(sample_t_ns, dtype=np.int64), np.asarray(sample_pa, dtype=np.float64))
        seen = _NOTHING_NEW if self._repeats(frame) else self._eye.measure(frame.image)
        shape = self._model.follow(frame, self._pressures, self._hook.carrying(weight_kg))
        self.measurement, self.shape = seen, shape
        if shape is not None:
            self._model_m = np.array(shape.tip_m, dtype=np.float64)
        row = np.zeros((), self._dtype)
        row["t_ns"], row["frame"] = frame.t_ns, frame.index
        row["protocol_s"], row["dropped"] = protocol_s, dropped
        row["seen"], row["model_ok"] = seen.seen, shape is not None
        row["pressure_pa"] = self._pressures.at(frame.t_ns)
        row["weight_kg"] = weight_kg
        row["measured_m"], row["covariance_m2"] = seen.tip_m, seen.covariance_m2
        row["reprojection_px"] = seen.reprojection_px
        row["model_m"] = self._model_m
        row["backbone_m"] = backbone(shape)
        row["truth_m"] = np.nan if frame.truth_m is None else frame.truth_m
        return row

    def _repeats(self, frame: Frame) -> bool:
        """Tell whether a picture is the last one once more: a camera that hangs measures nothing."""
        before, self._glimpse = self._glimpse, frame.image[::_GLIMPSE_ROWS].copy()
        if before is None or not np.array_equal(before, self._glimpse):
            return False
        return bool(before.min() != before.max())  # a picture all black or white has no noise to tell by
