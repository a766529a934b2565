"""Observer: for each frame set, the tip measured by vision and the tip modelled from the measured pressures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

import model
from model.arrays import Array
from protocols import TipReference
from protocols.tip_reference import NO_TIP_REFERENCE
from rig.config.arm_model import TipLoad, model_arm
from rig.config.schema import RigConfig
from rig.config.sections import Variant
from rig.execution.plan import observation_rows
from rig.hardware.cameras.base import FrameSet
from rig.hardware.trackers.base import TrackerReading
from rig.observation.camera_estimator import CameraTipEstimator
from rig.observation.live_model import LiveModel
from rig.observation.overlay import backbone
from rig.observation.sample_interpolator import SampleInterpolator
from rig.observation.tip_measurement import TipMeasurement
from runs.records import DetectionStatus, blank

if TYPE_CHECKING:
    from rig.observation.online_estimation import OnlineEstimation


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
        self._cameras = CameraTipEstimator(config) if config.cameras else None
        self._has_tracker = bool(config.trackers)
        self._sections = SectionObserver(config) if config.sections else None
        rate_hz = config.observation_hz
        self._model = LiveModel(model_arm(config, variant), 1 / rate_hz, config.model.mode == "static")
        self._tip_load = TipLoad(config)
        self._pressures = SampleInterpolator(config.actuators)
        self._tip_force, self._forces = MeasuredTipForce(config), SampleInterpolator(3)
        self._reference, self._protocol_times = reference, SampleInterpolator(1)
        self._blank = blank((), observation_rows(config))
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
        samples: NDArray[np.void],
        protocol_s: float,
        dropped: int = 0,
        weight_kg: float = 0.0,
    ) -> NDArray[np.void]:
        """Process one frame set with the control cycles (k,) of `sample_rows` since the last one; return a row ().

        `weight_kg` is the weight on the end cap. If the rig measures the force on the tip, this force includes the
        weight, and without it the model has no solution. `age_ns` stays zero; the caller sets it.
        """
        t_ns = samples["t_ns"]
        self._pressures.extend(t_ns, samples["measured_pa"])
        measured = self._measured(frame_set)
        force_n = np.zeros(3)
        if self._tip_force:
            self._forces.extend(t_ns, self._tip_force.of(samples["aux"]))
            weight_kg, force_n = 0.0, self._forces.at(frame_set.t_ns)
        shape = None
        if np.isfinite(force_n).all():
            shape = self._model.step(frame_set.t_ns, self._pressures, self._tip_load.carrying(weight_kg, force_n))
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
        if self._reference:
            self._set_reference(row, samples)
        if self._online_estimation is not None:
            self.adaptation = self._online_estimation.step(row)
        return row

    def _measured(self, frame_set: FrameSet) -> TipMeasurement:
        """The tip by the tracker of the rig, by its cameras, or none."""
        if self._has_tracker:
            return TipMeasurement.of_reading(frame_set.reading)
        return self._cameras.measure(frame_set) if self._cameras else TipMeasurement.none(DetectionStatus.NO_CAMERA, ())

    def _set_reference(self, row: NDArray[np.void], samples: NDArray[np.void]) -> None:
        """Set the reference at the time of a frame: the cycles around it give its protocol time."""
        self._protocol_times.extend(samples["t_ns"], samples["protocol_s"][:, None])
        t_s = float(self._protocol_times.at(int(row["t_ns"]))[0])
        row["reference_m"] = self._reference.position_m(t_s)
        row["predicted_m"] = self._reference.predicted_m([t_s])[0]
        row["learned_m"] = self._reference.learned_m([t_s])[0]
        row["tip_motion"], row["tip_period"] = self._reference.motion_and_period(t_s)


class SectionObserver:
    """The measured sections of the arm: each has a board of its own, which is measured as that of the tip is."""

    def __init__(self, config: RigConfig) -> None:
        self._estimators = [CameraTipEstimator(config.with_board_of(name)) for name in config.sections]
        self._s_m = np.array([section.at_mm * 1e-3 for section in config.sections.values()])

    def observe(self, row: NDArray[np.void], frame_set: FrameSet, shape: model.Shape | None) -> None:
        """Measure the sections in the next frame set; `shape` is the model's, None without convergence."""
        for k, estimator in enumerate(self._estimators):
            found = estimator.measure(frame_set)
            row["section_seen"][k] = found.seen
            row["section_m"][k], row["section_covariance_m2"][k] = found.tip_m, found.covariance_m2
            row["section_orientation_rad"][k] = found.rotation_vector
            row["section_orientation_covariance_rad2"][k] = found.pose_covariance[3:, 3:]
            row["section_reprojection_px"][k] = found.reprojection_px
        if shape is not None:
            row["section_model_m"] = shape.frames_at(self._s_m)[0]


def _set_clock(row: NDArray[np.void], reading: TrackerReading) -> None:
    """Set the columns of `TrackerClock`."""
    row["clock_offset_s"], row["clock_drift"] = reading.clock.offset_s, reading.clock.drift
    row["clock_std_s"], row["time_std_s"] = reading.clock.std_s, reading.time_std_s
    row["datagrams"], row["foreign_ipv4"] = reading.counts, reading.foreign_ipv4


class MeasuredTipForce:
    """The measured force on the tip: the sum of the components that auxiliary inputs of the rig measure."""

    def __init__(self, config: RigConfig) -> None:
        declared = {name: one.tip_force_direction for name, one in config.inputs.items()}
        self.inputs = tuple(name for name, direction in declared.items() if direction is not None)
        """Names of the inputs that measure a component; none if the rig does not measure the force."""
        self._columns = [list(declared).index(name) for name in self.inputs]
        directions = np.array([declared[name] for name in self.inputs], dtype=np.float64).reshape(-1, 3)
        self._axes = directions / np.linalg.norm(directions, axis=1, keepdims=True)

    def __bool__(self) -> bool:
        return bool(self.inputs)

    def of(self, values: Array) -> Array:
        """Force (k, 3) [N] on the arm in the rod-base frame from values of all inputs (k, I); NaN if one is missing."""
        return np.asarray(values[:, self._columns] @ self._axes)
