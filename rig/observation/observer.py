"""Observer: for each frame set, the tip measured by vision and the tip modelled from the measured pressures."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

import model
from model.dynamics import Dynamics
from model.statics import statics
from protocols import TipReference
from protocols.tip_reference import NO_TIP_REFERENCE
from rig.config.arm_model import TipLoad, model_arm
from rig.config.schema import RigConfig
from rig.config.sections import Variant
from rig.hardware.cameras.base import FrameSet
from rig.hardware.trackers.base import TrackerReading
from rig.observation.motion_model import motion_model
from rig.observation.multi_camera import MultiCameraTipEstimator
from rig.observation.overlay import backbone
from rig.observation.sections import SectionObserver
from rig.observation.single_camera import TipMeasurement
from rig.observation.tip_force import MeasuredTipForce
from runs.records import DetectionStatus, blank, observation_dtype

if TYPE_CHECKING:
    from rig.observation.online_estimation import OnlineEstimation

Floats = NDArray[np.float64]
Times = NDArray[np.int64]

# After a longer gap, in periods of the camera, the model restarts from the static solution instead of catching up.
_MOST_STEPS = 10
_EVEN = 1e-6
_HISTORY_NS = 1_000_000_000


class _LiveModel(Protocol):
    """The live model, static or dynamic."""

    def step(
        self, frame_set: FrameSet, pressures: PressureInterpolator, loads: model.Loads | None
    ) -> model.Shape | None:
        """Return the arm's shape at the time of the frame set; None without convergence."""


class _TipEstimator(Protocol):
    """Measures the tip in the rig's frame sets, in order."""

    def measure(self, frame_set: FrameSet) -> TipMeasurement: ...


class _NoTipEstimator:
    """The tip estimator of a rig without cameras and tracker: it measures nothing."""

    def measure(self, frame_set: FrameSet) -> TipMeasurement:
        return TipMeasurement.none(DetectionStatus.NO_CAMERA, ())


class _TrackerTipEstimator:
    """The tip estimator of a rig with a tracker, which gives the pose itself."""

    def measure(self, frame_set: FrameSet) -> TipMeasurement:
        reading = frame_set.reading
        if reading is None or not reading.seen:
            return TipMeasurement.none(DetectionStatus.NO_MESSAGE if reading is None else DetectionStatus.NO_POSE, ())
        return TipMeasurement(
            DetectionStatus.MEASURED, reading.position_m, reading.rotation, reading.covariance, float("nan"), None, ()
        )


def _tip_estimator(config: RigConfig) -> _TipEstimator:
    if config.trackers:
        return _TrackerTipEstimator()
    return MultiCameraTipEstimator(config) if config.cameras else _NoTipEstimator()


class PressureInterpolator:
    """Linear interpolation of the pressures of the last second."""

    def __init__(self, actuators: int) -> None:
        self._t_ns: Times = np.empty(0, np.int64)
        self._pa: Floats = np.empty((0, actuators))

    def extend(self, t_ns: Times, pa: Floats) -> None:
        """Append samples `t_ns` (k,), `pa` (k, N); samples that are not newer than the last are ignored."""
        if self._t_ns.size:
            new = t_ns > self._t_ns[-1]
            t_ns, pa = t_ns[new], pa[new]
        if t_ns.size:
            keep = self._t_ns > t_ns[-1] - _HISTORY_NS
            self._t_ns = np.concatenate([self._t_ns[keep], t_ns])
            self._pa = np.concatenate([self._pa[keep], pa])

    @property
    def first_ns(self) -> int | None:
        """Time of the first sample that is kept; None before any."""
        return int(self._t_ns[0]) if self._t_ns.size else None

    def at(self, t_ns: int) -> Floats:
        """Return pressures (N,) [Pa] at a time, the nearest sample beyond the ends; NaN before the first."""
        if not self._t_ns.size:
            return np.full(self._pa.shape[1], np.nan)
        after = int(np.searchsorted(self._t_ns, t_ns))
        if after == 0 or after == len(self._t_ns):
            return np.array(self._pa[min(after, len(self._t_ns) - 1)])
        # Subtract in int64: a float64 cannot represent nanoseconds since boot exactly.
        before_ns = int(self._t_ns[after - 1])
        share = (t_ns - before_ns) / (int(self._t_ns[after]) - before_ns)
        return np.array(self._pa[after - 1] + share * (self._pa[after] - self._pa[after - 1]))


class _StaticModel:
    """Statics at every frame."""

    def __init__(self, arm: model.Arm) -> None:
        self._arm = arm

    def step(
        self, frame_set: FrameSet, pressures: PressureInterpolator, loads: model.Loads | None
    ) -> model.Shape | None:
        return _static_shape(partial(statics, self._arm, doubt_units=False), pressures.at(frame_set.t_ns), loads)


class _DynamicModel:
    """Dynamics from frame to frame: over the time between them, in equal steps of about the camera's stated period.

    An arm that remembers begins at the first sample known, and takes longer steps over a gap, however long: its past
    must not be lost.
    """

    def __init__(self, dynamics: Dynamics, period_s: float, remembers: bool) -> None:
        self._dynamics, self._remembers = dynamics, remembers
        self._period_ns = period_s * 1e9
        self._last: tuple[int, model.Shape] | None = None

    def step(
        self, frame_set: FrameSet, pressures: PressureInterpolator, loads: model.Loads | None
    ) -> model.Shape | None:
        last, self._last = self._last, None
        if last is None and self._remembers:
            last = self._begin(frame_set.t_ns, pressures, loads)
        passed_ns = frame_set.t_ns - last[0] if last is not None else 0
        steps = max(1, round(passed_ns / self._period_ns))
        if self._remembers:
            steps = min(steps, _MOST_STEPS)
        if last is None or passed_ns <= 0 or steps > _MOST_STEPS:
            shape = _static_shape(self._dynamics.start, pressures.at(frame_set.t_ns), loads)
        elif passed_ns * 1e-9 < self._dynamics.shortest_step_s:
            # Too short for the waves that the nodes resolve: the next frame takes a step over both.
            self._last = last
            return last[1]
        else:
            shape = None
            for k in range(1, steps + 1):
                pressure = pressures.at(last[0] + passed_ns * k // steps)
                finite = np.all(np.isfinite(pressure))
                shape = self._dynamics.step(pressure, loads, self._step_s(passed_ns / steps)) if finite else None
                if shape is None or not shape.ok:
                    # The next frame restarts from statics, because the history has a gap.
                    return None
        if shape is not None:
            self._last = frame_set.t_ns, shape
        return shape

    def _begin(
        self, t_ns: int, pressures: PressureInterpolator, loads: model.Loads | None
    ) -> tuple[int, model.Shape] | None:
        """Time and shape at the first sample, at rest; None where there is none before the frame, or no solution."""
        first_ns = pressures.first_ns
        if first_ns is None or first_ns >= t_ns:
            return None
        shape = _static_shape(self._dynamics.start, pressures.at(first_ns), loads)
        return None if shape is None else (first_ns, shape)

    def _step_s(self, step_ns: float) -> float | None:
        """The step, None for the stated period: times in whole nanoseconds do not count as uneven."""
        return None if abs(step_ns - self._period_ns) < _EVEN * self._period_ns else step_ns * 1e-9


def _static_shape(solve: _Solve, pressure: Floats, loads: model.Loads | None) -> model.Shape | None:
    if not np.all(np.isfinite(pressure)):
        return None
    try:
        shape = solve(pressure, loads)
    except model.NotConverged:
        return None
    return shape if shape.ok else None


class _Solve(Protocol):
    def __call__(self, pressure_pa: Floats, loads: model.Loads | None, /) -> model.Shape: ...


def observations_of(config: RigConfig) -> np.dtype[np.void]:
    """The dtype of the rows of the observer of a rig."""
    return observation_dtype(
        config.actuators, len(config.cameras), bool(config.trackers), config.triggered, len(config.sections)
    )


class Observer:
    """Converts frame sets, in order, to rows of `runs.records.observation_dtype`. It uses no clock."""

    def __init__(
        self,
        config: RigConfig,
        variant: Variant | None = None,
        adapt: Sequence[str] = (),
        reference: TipReference = NO_TIP_REFERENCE,
    ) -> None:
        """`variant` of the model (the rig's when None); `reference` is that of the tip.

        `adapt` names the parameters of the recursive estimator, which then predicts the model's tip.
        """
        # The pictures are small; a second thread only takes CPU time from the control process.
        cv2.setNumThreads(1)
        self._tip_estimator: _TipEstimator = _tip_estimator(config)
        self._sections = SectionObserver(config) if config.sections else None
        rate_hz = config.observation_hz
        arm = model_arm(config, variant)
        dynamics = motion_model(arm, 1 / rate_hz, config.model.mode == "static")
        self._model: _LiveModel = (
            _StaticModel(arm) if dynamics is None else _DynamicModel(dynamics, 1 / rate_hz, arm.remembers)
        )
        self._tip_load = TipLoad(config)
        self._pressures = PressureInterpolator(config.actuators)
        self._tip_force, self._forces = MeasuredTipForce(config), PressureInterpolator(3)
        self._reference, self._protocol_times = reference, PressureInterpolator(1)
        self._blank = blank((), observations_of(config))
        self._model_m = np.full(3, np.nan)
        self.measurement: TipMeasurement | None = None
        """Measurement of the last frame set; `shape` is the model's. For overlays."""
        self.shape: model.Shape | None = None
        self.adaptation: NDArray[np.void] | None = None
        """Row of the estimator for the last frame set; None without an estimator."""
        self._online_estimation: OnlineEstimation | None = None
        if adapt:
            from rig.observation.online_estimation import OnlineEstimation

            self._online_estimation = OnlineEstimation(config, variant, adapt)

    def step(
        self,
        frame_set: FrameSet,
        sample_t_ns: Times,
        sample_pa: Floats,
        protocol_s: float,
        dropped: int = 0,
        weight_kg: float = 0.0,
        sample_protocol_s: Floats | None = None,
        sample_aux: Floats | None = None,
    ) -> NDArray[np.void]:
        """Process one frame set with the samples (k,), (k, N) since the last one; return a row ().

        `weight_kg` is the weight on the end cap. `sample_protocol_s` (k,), the protocol times of the samples, give the
        reference of the tip at the time of the frame. `sample_aux` (k, I), the auxiliary inputs, give the force on the
        tip if the rig measures it: this force then includes the weight, and without it the model has no solution.
        `age_ns` stays zero; the caller sets it.
        """
        self._pressures.extend(np.asarray(sample_t_ns, dtype=np.int64), np.asarray(sample_pa, dtype=np.float64))
        measured = self._tip_estimator.measure(frame_set)
        force_n = np.zeros(3)
        if self._tip_force:
            if sample_aux is not None:
                self._forces.extend(np.asarray(sample_t_ns, dtype=np.int64), self._tip_force.of(sample_aux))
            weight_kg, force_n = 0.0, self._forces.at(frame_set.t_ns)
        shape = None
        if np.isfinite(force_n).all():
            shape = self._model.step(frame_set, self._pressures, self._tip_load.carrying(weight_kg, force_n))
        self.measurement, self.shape = measured, shape
        if shape is not None:
            self._model_m = np.array(shape.tip_m, dtype=np.float64)
        row = self._blank.copy()
        row["t_ns"], row["frame"] = frame_set.t_ns, frame_set.index
        row["protocol_s"], row["dropped"] = protocol_s, dropped
        row["seen"], row["model_ok"] = measured.seen, shape is not None
        row["pressure_pa"] = self._pressures.at(frame_set.t_ns)
        row["weight_kg"], row["force_n"] = weight_kg, force_n
        row["measured_m"], row["covariance_m2"] = measured.tip_m, measured.covariance_m2
        row["orientation_rad"] = measured.rotation_vector
        row["orientation_covariance_rad2"] = measured.pose_covariance[3:, 3:]
        row["cross_covariance_m_rad"] = measured.pose_covariance[:3, 3:]
        row["reprojection_px"] = measured.reprojection_px
        row["model_m"] = self._model_m
        row["backbone_m"] = backbone(shape)
        row["truth_m"] = np.nan if frame_set.truth_m is None else frame_set.truth_m
        row["camera_seen"] = measured.cameras
        row["camera_skew_s"] = [np.nan if f is None else (f.t_ns - frame_set.t_ns) * 1e-9 for f in frame_set.frames]
        if frame_set.reading is not None:
            _set_clock(row, frame_set.reading)
        if self._sections is not None:
            self._sections.observe(row, frame_set, shape)
        for k, match in enumerate(frame_set.triggers):
            if match is not None:
                row["stamp_delay_s"][k], row["untriggered"][k] = match.stamp_delay_ns * 1e-9, match.untriggered
        if self._reference and sample_protocol_s is not None:
            self._set_reference(row, sample_t_ns, sample_protocol_s)
        if self._online_estimation is not None:
            self.adaptation = self._online_estimation.step(row)
        return row

    def _set_reference(self, row: NDArray[np.void], sample_t_ns: Times, sample_protocol_s: Floats) -> None:
        """Set the reference at the time of a frame: the cycles around it give its protocol time."""
        self._protocol_times.extend(sample_t_ns, sample_protocol_s[:, None])
        t_s = float(self._protocol_times.at(int(row["t_ns"]))[0])
        row["reference_m"] = self._reference.position_m(t_s)
        row["predicted_m"] = self._reference.predicted_m([t_s])[0]
        row["learned_m"] = self._reference.learned_m([t_s])[0]
        row["tip_motion"], row["tip_period"] = self._reference.motion_and_period(t_s)


def _set_clock(row: NDArray[np.void], reading: TrackerReading) -> None:
    """Set the columns of `TrackerClock`."""
    row["clock_offset_s"], row["clock_drift"] = reading.clock.offset_s, reading.clock.drift
    row["clock_std_s"], row["time_std_s"] = reading.clock.std_s, reading.time_std_s
    row["datagrams"] = reading.counts
