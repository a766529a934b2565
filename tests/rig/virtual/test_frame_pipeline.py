"""The frame pipeline of a virtual run: the end or the error of a child ends the run with the reason."""

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
from rig.hardware.cameras.base import Frame, FrameSet
from rig.virtual import executor
from rig.virtual.frame_pipeline import FramePipeline, FrameProcessError, FrameResult, FrameSamples, FrameStages
from runs.records import Event, Status

SHAPE = (4, 6)
SAMPLES = FrameSamples(b"", 0.0, 0.0)


class Numbers(FrameStages):
    """Stages without a camera: the picture holds the frame's number, the result its sum."""

    def __init__(self) -> None:
        super().__init__((), None, None, None)  # type: ignore[arg-type]

    def render(self, index: int, due_ns: int, exposures: object) -> FrameSet:
        """A picture of the number; the second camera gives none."""
        return FrameSet(index, (Frame(index, 10 * index, np.full(SHAPE, index, np.uint8)), None))

    def measure(self, frame_set: FrameSet, samples: FrameSamples) -> FrameResult:
        """The sum of the picture."""
        return FrameResult(repr((frame_set.t_ns, int(frame_set.lead.image.sum()))).encode(), None, [])


class Failing(Numbers):
    """Stages of which one raises."""

    def __init__(self, stage: str) -> None:
        super().__init__()
        self._stage = stage

    def render(self, index: int, due_ns: int, exposures: object) -> FrameSet:
        """Raise if it is this stage's turn."""
        if self._stage == "render":
            raise ValueError("no light")
        return super().render(index, due_ns, exposures)

    def measure(self, frame_set: FrameSet, samples: FrameSamples) -> FrameResult:
        """Raise."""
        raise ValueError("no board")


def test_results_come_in_the_order_of_the_frames_with_the_pictures_of_their_own() -> None:
    with FramePipeline(Numbers(), 2, SHAPE) as pipeline:
        for index in range(1, 31):
            pipeline.submit(index, 0, (), SAMPLES)
        found = [pipeline.result().observation.decode() for _ in range(30)]
    assert found == [repr((10 * index, 24 * index)) for index in range(1, 31)]


class Large(Numbers):
    """Stages whose results are as large as pictures."""

    def measure(self, frame_set: FrameSet, samples: FrameSamples) -> FrameResult:
        """A result that fills most of a pipe."""
        return FrameResult(bytes(50_000), None, [])


def test_samples_and_results_larger_than_a_pipe_do_not_stop_it() -> None:
    samples = FrameSamples(bytes(50_000), 0.0, 0.0)
    with FramePipeline(Large(), 2, SHAPE) as pipeline:
        for index in range(1, 31):
            pipeline.submit(index, 0, (), samples)
        assert [len(pipeline.result().observation) for _ in range(30)] == [50_000] * 30


@pytest.mark.parametrize(
    ("stage", "message"), [("render", "ValueError: no light"), ("measure", "ValueError: no board")]
)
def test_an_error_in_a_child_is_raised_with_its_traceback(stage: str, message: str) -> None:
    with FramePipeline(Failing(stage), 2, SHAPE) as pipeline:
        pipeline.submit(1, 0, (), SAMPLES)
        with pytest.raises(FrameProcessError, match=message) as raised:
            pipeline.result()
        assert pipeline.in_flight == 0
    assert f"in {stage}" in "".join(raised.value.__notes__)


@pytest.mark.parametrize(("does", "code"), [("renders", "-9"), ("measures", "-9")])
def test_a_killed_child_is_named(does: str, code: str) -> None:
    with FramePipeline(Numbers(), 2, SHAPE) as pipeline:
        pipeline._children[does].kill()

        def frames() -> None:
            for index in range(30):
                pipeline.submit(index, 0, (), SAMPLES)
            for _ in range(30):
                pipeline.result()

        with pytest.raises(
            FrameProcessError, match=f"the process that {does} the pictures ended with exit code {code}"
        ):
            frames()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_to_the_process_group_ends_no_child(number: signal.Signals) -> None:
    with FramePipeline(Numbers(), 2, SHAPE) as pipeline:
        pipeline.submit(1, 0, (), SAMPLES)
        pipeline.result()
        for child in pipeline._children.values():
            assert child.pid is not None
            os.kill(child.pid, number)
        pipeline.submit(2, 0, (), SAMPLES)
        assert pipeline.result().observation == repr((20, 48)).encode()


def test_the_children_end_with_the_process_of_the_run() -> None:
    with FramePipeline(Numbers(), 2, SHAPE) as pipeline:
        for pipe in (pipeline._exposures, pipeline._samples):
            pipe.close()
        for child in pipeline._children.values():
            child.join(60)
            assert child.exitcode == 0


def test_a_run_whose_child_is_killed_is_aborted_with_its_valves_safe(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kill: list[Callable[[], None]] = []

    class Watched(FramePipeline):
        """Remembers how to kill its child."""

        def __init__(self, stages: FrameStages, cameras: int, shape: tuple[int, int]) -> None:
            super().__init__(stages, cameras, shape)
            kill.append(self._children["measures"].kill)

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
    request = experiment.request(str(protocol), "mock", folder=tmp_path, fast=True, seed=1, report=False)
    killer = Killer()
    result = experiment.run(request, experiment.plan(request), killer)
    assert result.outcome.status is Status.ABORTED
    assert "the process that measures the pictures ended with exit code -9" in result.outcome.message
    assert killer.messages[-1].startswith("the valves are in their safe state; the pressures are low ")
    assert result.archive is not None
    assert runs.open(result.archive).status is Status.ABORTED
