"""A frame pipeline without processes of its own, for the benchmarks."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rig.virtual.frame_pipeline import FrameRequest, FrameResult, FrameStages


class InlinePipeline:
    """A frame pipeline that renders and measures at once in the process of control."""

    def __init__(self, stages: FrameStages) -> None:
        self._stages = stages
        self._results: deque[FrameResult] = deque()

    def __enter__(self) -> InlinePipeline:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    @property
    def in_flight(self) -> int:
        """Frame sets whose results have not been returned."""
        return len(self._results)

    def submit(self, request: FrameRequest) -> None:
        """Measure a frame set."""
        self._results.append(self._stages.measure(request))

    def result(self) -> FrameResult:
        """The result of the oldest frame set."""
        return self._results.popleft()
