"""Frame pipeline of a virtual run: one child process renders the frame sets, a second one measures them."""

from __future__ import annotations

import mmap
import multiprocessing
import os
import signal
import traceback
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import ForkProcess
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from rig.hardware.cameras.base import Frame, FrameSet
from rig.hardware.cameras.mock import Exposure, MockCamera
from rig.observation.observer import Observer
from rig.observation.picture_recorder import PictureRecorder
from runs.records import Picture

MOST_IN_FLIGHT = 40
"""Frame sets for which the shared memory has room."""

_LESS_URGENT = 5
"""Rendering waits where processors are short: measuring takes longer and sets the pace."""

_FORK = multiprocessing.get_context("fork")
_CLOSED = (EOFError, OSError)


@dataclass(frozen=True)
class FrameSamples:
    """What the observer needs beside the pictures: the samples `t_ns` (k,), `measured_pa` (k, N) and `aux` (k, I; None
    without auxiliary inputs) since the last frame set and their protocol times, the protocol time of the newest one and
    the weight on the end cap.
    """

    t_ns: NDArray[np.int64]
    measured_pa: NDArray[np.float64]
    protocol_s: float
    weight_kg: float
    protocol_times_s: NDArray[np.float64]
    aux: NDArray[np.float64] | None


@dataclass(frozen=True)
class FrameResult:
    """The observer's row and that of its estimator as bytes (None without an estimator), and the pictures to record."""

    observation: bytes
    adaptation: bytes | None
    pictures: list[Picture]


@dataclass(frozen=True)
class _RenderedFrame:
    """A frame whose picture is in shared memory."""

    index: int
    t_ns: int
    shape: tuple[int, int]
    truth_m: NDArray[np.float64] | None


@dataclass(frozen=True)
class _Failure:
    """An exception in a child process."""

    message: str
    traceback: str


class FrameProcessError(Exception):
    """A child process has failed or ended; the notes hold its traceback if there is one."""

    def __init__(self, message: str, *tracebacks: str) -> None:
        super().__init__(message)
        self.__notes__ = list(tracebacks)


class FrameStages:
    """The two stages of a frame set: the cameras' pictures, then the observer's row."""

    def __init__(self, cameras: Sequence[MockCamera], observer: Observer, recorder: PictureRecorder) -> None:
        self._cameras, self._observer, self._recorder = cameras, observer, recorder

    def render(self, index: int, due_ns: int, exposures: Sequence[Exposure | None]) -> FrameSet:
        """Render the frame set due at a time; an exposure that is None is a camera without a frame."""
        frames = (
            None if exposure is None else camera.develop(exposure)
            for camera, exposure in zip(self._cameras, exposures, strict=True)
        )
        return FrameSet(index, tuple(frames), due_ns)

    def measure(self, frame_set: FrameSet, samples: FrameSamples) -> FrameResult:
        """Measure the next frame set."""
        row = self._observer.step(
            frame_set, samples.t_ns, samples.measured_pa, samples.protocol_s, 0, samples.weight_kg,
            samples.protocol_times_s, samples.aux,
        )  # fmt: skip
        adaptation = self._observer.adaptation
        return FrameResult(
            row.tobytes(),
            None if adaptation is None else adaptation.tobytes(),
            self._recorder.pictures(frame_set, self._observer),
        )


class FramePipeline:
    """Runs the stages of every frame set in two child processes, in the order of the frame sets.

    The children are forked: they share imported libraries and compiled kernels with this process. Pictures go from one
    to the other through shared memory. The children end when their pipes close, and so with this process.
    """

    def __init__(self, stages: FrameStages, cameras: int, shape: tuple[int, int]) -> None:
        """Start the children; `shape` (height, width) is the largest of the pictures."""
        self.in_flight = 0
        """Frame sets whose results have not been received."""
        size = MOST_IN_FLIGHT * cameras * shape[0] * shape[1]
        memory = mmap.mmap(-1, max(1, size))
        pictures = np.frombuffer(memory, np.uint8, size).reshape(MOST_IN_FLIGHT, cameras, *shape)
        exposures, self._exposures = _FORK.Pipe(duplex=False)
        samples, self._samples = _FORK.Pipe(duplex=False)
        frame_sets, rendered = _FORK.Pipe(duplex=False)
        self._results, results = _FORK.Pipe(duplex=False)
        pipes = (exposures, self._exposures, samples, self._samples, frame_sets, rendered, self._results, results)

        def render() -> None:
            os.nice(_LESS_URGENT)
            _render(stages, exposures, pictures, rendered)

        def measure() -> None:
            _measure(stages, frame_sets, pictures, samples, results)

        self._children = {
            "renders": _forked(render, [pipe for pipe in pipes if pipe not in (exposures, rendered)]),
            "measures": _forked(measure, [pipe for pipe in pipes if pipe not in (frame_sets, samples, results)]),
        }
        for pipe in (exposures, samples, frame_sets, rendered, results):
            pipe.close()

    def __enter__(self) -> FramePipeline:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for pipe in (self._exposures, self._samples, self._results):
            pipe.close()
        for child in self._children.values():
            child.kill()
            child.join()

    def submit(self, index: int, due_ns: int, exposures: Sequence[Exposure | None], samples: FrameSamples) -> None:
        """Pass on the next frame set, due at a time.

        Raises:
            FrameProcessError: a child has ended.
        """
        assert self.in_flight < MOST_IN_FLIGHT
        try:
            self._exposures.send((index, due_ns, exposures))
            self._samples.send(samples)
        except OSError as error:
            raise self._ended() from error
        self.in_flight += 1

    def result(self) -> FrameResult:
        """Wait for the result of the oldest frame set in flight.

        Raises:
            FrameProcessError: a child has failed or ended; no frame set is in flight then.
        """
        try:
            result: FrameResult | _Failure = self._results.recv()
        except _CLOSED as error:
            raise self._ended() from error
        if isinstance(result, _Failure):
            self.in_flight = 0
            raise FrameProcessError(result.message, result.traceback)
        self.in_flight -= 1
        return result

    def _ended(self) -> FrameProcessError:
        self.in_flight = 0
        for child in self._children.values():
            child.join(timeout=1.0)
        ended = [
            f"the process that {does} the pictures ended with exit code {child.exitcode}"
            for does, child in self._children.items()
            if child.exitcode
        ]
        return FrameProcessError("; ".join(ended) or "the processes that render and measure the pictures ended")


def _render(stages: FrameStages, exposures: Connection, pictures: NDArray[np.uint8], rendered: Connection) -> None:
    slot = 0
    while True:
        index, due_ns, exposed = exposures.recv()
        try:
            frame_set = stages.render(index, due_ns, exposed)
        except Exception as error:
            rendered.send(_failure(error))
            return
        heads: list[_RenderedFrame | None] = []
        for picture, frame in zip(pictures[slot], frame_set.frames, strict=True):
            if frame is None:
                heads.append(None)
                continue
            height, width = frame.image.shape
            picture[:height, :width] = frame.image
            heads.append(_RenderedFrame(frame.index, frame.t_ns, (height, width), frame.truth_m))
        rendered.send((index, due_ns, slot, heads))
        slot = (slot + 1) % len(pictures)


def _measure(
    stages: FrameStages,
    frame_sets: Connection,
    pictures: NDArray[np.uint8],
    samples: Connection,
    results: Connection,
) -> None:
    while True:
        received = frame_sets.recv()
        if isinstance(received, _Failure):
            results.send(received)
            return
        index, due_ns, slot, heads = received
        frames = tuple(
            None
            if head is None
            else Frame(head.index, head.t_ns, picture[: head.shape[0], : head.shape[1]], head.truth_m)
            for head, picture in zip(heads, pictures[slot], strict=True)
        )
        try:
            result = stages.measure(FrameSet(index, frames, due_ns), samples.recv())
        except Exception as error:
            results.send(_failure(error))
            return
        results.send(result)


def _failure(error: Exception) -> _Failure:
    return _Failure(f"{type(error).__name__}: {error}", "".join(traceback.format_exception(error)))


def _forked(stage: Callable[[], None], others: Sequence[Connection]) -> ForkProcess:
    """Fork a child that runs a stage until its pipes close; `others` are the ends of pipes that it does not use."""

    def child() -> None:
        # A signal to the whole process group is for the parent, which ends the run in order.
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)
        for pipe in others:
            pipe.close()
        try:
            stage()
        except _CLOSED:
            return

    process = _FORK.Process(target=child, daemon=True)
    with warnings.catch_warnings():
        # Python warns of every fork beside other threads. Those of NumPy survive a fork, and no other is started
        # before the children.
        warnings.simplefilter("ignore", DeprecationWarning)
        process.start()
    return process
