"""The frame pipeline of a virtual run: the end or the error of its child ends the run with the reason."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import runs
from rig.execution.plan import NullOperator
from rig.experiment import run as experiment
from rig.experiment.options import RunOptions
from rig.experiment.prepare import prepare
from rig.hardware.cameras.base import Frame, FrameSet
from rig.virtual import executor
from rig.virtual.frame_pipeline import FramePipeline, FrameProcessError, FrameRequest, FrameResult, FrameStages
from runs.records import Event, Status

SHAPE = (4, 6)


def request(index: int, rows: bytes = b"") -> FrameRequest:
    """A request of a frame set."""
    return FrameRequest(index, 0, rows, 0.0, 0.0, 0)


class Numbers(FrameStages):
    """Stages without a camera: the picture holds the frame's number, the result its sum."""

    def __init__(self) -> None:
        super().__init__((), None, None, None)  # type: ignore[arg-type]

    def render(self, request: FrameRequest) -> FrameSet:
        """A picture of the number; the second camera gives none."""
        index = request.index
        return FrameSet(index, (Frame(index, 10 * index, np.full(SHAPE, index, np.uint8)), None))

    def measure(self, request: FrameRequest) -> FrameResult:
        """The sum of the picture."""
        frame_set = self.render(request)
        return FrameResult(repr((frame_set.t_ns, int(frame_set.lead.image.sum()))).encode(), None, [])


class Failing(Numbers):
    """Stages of which one raises."""

    def __init__(self, stage: str) -> None:
        super().__init__()
        self._stage = stage

    def render(self, request: FrameRequest) -> FrameSet:
        """Raise if it is this stage's turn."""
        if self._stage == "render":
            raise ValueError("no light")
        return super().render(request)

    def measure(self, request: FrameRequest) -> FrameResult:
        """Raise."""
        self.render(request)
        raise ValueError("no board")


def test_results_come_in_the_order_of_the_frames_with_the_pictures_of_their_own() -> None:
    with FramePipeline(Numbers()) as pipeline:
        for index in range(1, 31):
            pipeline.submit(request(index))
        found = [pipeline.result().observation.decode() for _ in range(30)]
    assert found == [repr((10 * index, 24 * index)) for index in range(1, 31)]


class Large(Numbers):
    """Stages whose results are as large as pictures."""

    def measure(self, request: FrameRequest) -> FrameResult:
        """A result that fills most of a pipe."""
        return FrameResult(bytes(50_000), None, [])


def test_samples_and_results_larger_than_a_pipe_do_not_stop_it() -> None:
    with FramePipeline(Large()) as pipeline:
        for index in range(1, 31):
            pipeline.submit(request(index, bytes(50_000)))
        assert [len(pipeline.result().observation) for _ in range(30)] == [50_000] * 30


@pytest.mark.parametrize(
    ("stage", "message"), [("render", "ValueError: no light"), ("measure", "ValueError: no board")]
)
def test_an_error_in_a_child_is_raised_with_its_traceback(stage: str, message: str) -> None:
    with FramePipeline(Failing(stage)) as pipeline:
        pipeline.submit(request(1))
        with pytest.raises(FrameProcessError, match=message) as raised:
            pipeline.result()
        assert pipeline.in_flight == 0
    assert f"in {stage}" in "".join(raised.value.__notes__)


def test_a_killed_child_is_named() -> None:
    with FramePipeline(Numbers()) as pipeline:
        pipeline._child.kill()

        def frames() -> None:
            for index in range(30):
                pipeline.submit(request(index))
            for _ in range(30):
                pipeline.result()

        with pytest.raises(
            FrameProcessError, match="the process that renders and measures the pictures ended with exit code -9"
        ):
            frames()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_to_the_process_group_does_not_end_the_child(number: signal.Signals) -> None:
    with FramePipeline(Numbers()) as pipeline:
        pipeline.submit(request(1))
        pipeline.result()
        assert pipeline._child.pid is not None
        os.kill(pipeline._child.pid, number)
        pipeline.submit(request(2))
        assert pipeline.result().observation == repr((20, 48)).encode()


def test_the_child_ends_with_the_process_of_the_run() -> None:
    with FramePipeline(Numbers()) as pipeline:
        pipeline._requests.close()
        pipeline._child.join(60)
        assert pipeline._child.exitcode == 0


def test_a_run_whose_child_is_killed_is_aborted_with_its_valves_safe(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kill: list[Callable[[], None]] = []

    class Watched(FramePipeline):
        """Remembers how to kill its child."""

        def __init__(self, stages: FrameStages) -> None:
            super().__init__(stages)
            kill.append(self._child.kill)

    class Killer(NullOperator):
        """Kills the child at the first poll."""

        def __init__(self) -> None:
            self.messages: list[str] = []

        def report(self, event: Event) -> None:
            """Remember."""
            self.messages.append(event.message)

        def stop_requested(self) -> str | None:
            """Kill."""
            kill[0]()
            return None

    monkeypatch.setattr(executor, "FramePipeline", Watched)
    protocol = tmp_path / "protocol.yaml"
    protocol.write_text("title: For a test\nsteps:\n  - hold: {duration_s: 600}\n")
    prepared = prepare(str(protocol), "mock", RunOptions(out=tmp_path, fast=True, seed=1, report=False))
    killer = Killer()
    result = experiment.run(prepared, killer)
    assert result.outcome.status is Status.ABORTED
    assert "the process that renders and measures the pictures ended with exit code -9" in result.outcome.message
    assert killer.messages[-1].startswith("the valves are in their safe state; the pressures are low ")
    assert result.archive is not None
    assert runs.open(result.archive).status is Status.ABORTED
