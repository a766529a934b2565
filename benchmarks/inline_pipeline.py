"""A frame pipeline without processes of its own, for the benchmarks."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rig.simulator.mock_camera import Exposure
    from rig.virtual.frame_pipeline import FrameResult, FrameSamples, FrameStages


class InlinePipeline:
    """A frame pipeline that renders and measures at once in the process of control."""

    def __init__(self, stages: FrameStages, cameras: int, shape: tuple[int, int]) -> None:
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

    def submit(self, index: int, due_ns: int, exposures: Sequence[Exposure | None], samples: FrameSamples) -> None:
        """Measure a frame set."""
        self._results.append(self._stages.measure(self._stages.render(index, due_ns, exposures), samples))

    def result(self) -> FrameResult:
        """The result of the oldest frame set."""
        return self._results.popleft()
