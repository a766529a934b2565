"""Publishing camera frames to those who watch: nothing is computed or copied while nobody does."""

from __future__ import annotations

import time

import numpy as np

from rig.cameras.base import Frame
from rig.config import RigConfig
from rig.executor.memory import LINE_POINTS, RunMemory, view_dtype
from rig.observer import Observer
from rig.sketch import Sketcher

WATCHED_NS = 3_000_000_000
"""A page says about once a second that it is there."""


class Show:
    """The observer's shop window."""

    def __init__(self, config: RigConfig, camera: str, memory: RunMemory) -> None:
        self._memory = memory
        self._sketcher = Sketcher(config, camera, LINE_POINTS)
        self._row = np.zeros((), view_dtype(memory.layout))

    def frame(self, frame: Frame, observer: Observer) -> None:
        """Publish the frame that the observer has just observed, if somebody watches."""
        watched = time.monotonic_ns() - self._memory.get("watched_ns") <= WATCHED_NS
        if not watched or observer.measurement is None:
            return
        sketch = self._sketcher.sketch(observer.measurement, observer.shape)
        row = self._row
        row["t_ns"], row["frame"] = frame.t_ns, frame.index
        row["shape"] = (*frame.image.shape, 1)[:3]
        row["found"] = len(sketch.corners_px)
        row["corners_px"][: len(sketch.corners_px)] = sketch.corners_px
        row["tip_px"], row["model_px"], row["lines_m"] = sketch.tip_px, sketch.model_px, sketch.lines_m
        self._memory.push_view(row, frame.image)
