"""The measured sections of the arm: each has a board of its own, which is measured as that of the tip is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import model
from rig.config.schema import RigConfig
from rig.hardware.cameras.base import FrameSet
from rig.observation.multi_camera import MultiCameraTipEstimator


class SectionObserver:
    """Sets the columns of `Sections` in the rows of the observer."""

    def __init__(self, config: RigConfig) -> None:
        self._estimators = [MultiCameraTipEstimator(config.with_board_of(name)) for name in config.sections]
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
