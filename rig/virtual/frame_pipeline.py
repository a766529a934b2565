"""Frame pipeline of a virtual run: one child process renders the frame sets, a second one measures them."""

from __future__ import annotations

import fcntl
import mmap
import multiprocessing
import os
import signal
import threading
import traceback
import warnings
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from multiprocessing.context import ForkProcess
from queue import SimpleQueue

import numpy as np
from numpy.typing import NDArray

from rig.hardware.cameras.base import Frame, FrameSet
from rig.hardware.trackers.base import TrackerReading
from rig.observation.observer import Observer
from rig.observation.picture_recorder import PictureRecorder
from rig.observation.tip_force import auxiliary_values
from rig.simulator.mock_camera import Exposure, MockCamera
from runs.records import Picture

MOST_IN_FLIGHT = 40
"""Frame sets that fit in the shared memory."""
_BATCH = 6
"""Frame sets in one message: a message costs several times what its content does."""
_PIPE_BYTES = 1 << 20
"""Room for the pictures of some batches: through a pipe of the usual 64 KiB a batch travels in pieces."""

_LESS_URGENT = 5
"""Rendering waits where processors are short: measuring takes longer and sets the pace."""

_FORK = multiprocessing.get_context("fork")
_CLOSED = (EOFError, OSError)


@dataclass(frozen=True)
class FrameSamples:
    """What the observer needs beside the pictures: the samples since the last frame set as bytes of the rows that the
    run records, the protocol time of the newest one and the weight on the end cap; the frames or readings `dropped`
    before. With a tracker its `reading`, None where it was silent.
    """

    rows: bytes
    protocol_s: float
    weight_kg: float
    reading: TrackerReading | None = None
    dropped: int = 0


@dataclass(frozen=True)
class FrameResult:
    """The observer's row and that of its estimator as bytes (None without an estimator), and the pictures to record."""

    observation: bytes
    adaptation: bytes | None
    pictures: list[Picture]


@dataclass(frozen=True)
class _Failure:
    """An exception in a child process."""

    message: str
    traceback: str


_Request = tuple[tuple[int, int, Sequence[Exposure | None]], FrameSamples]
"""Number, due time and exposures of a frame set, and the samples beside it."""


class FrameProcessError(Exception):
    """A child process has failed or ended; the notes hold its traceback if there is one."""

    def __init__(self, message: str, *tracebacks: str) -> None:
        super().__init__(message)
        self.__notes__ = list(tracebacks)


class FrameStages:
    """The two stages of a frame set: the cameras' pictures, then the observer's row."""

    def __init__(
        self,
        cameras: Sequence[MockCamera],
        observer: Observer,
        recorder: PictureRecorder,
        sample_rows: np.dtype[np.void],
    ) -> None:
        """`sample_rows` is the type of the rows in `FrameSamples`."""
        self._cameras, self._observer, self._recorder = cameras, observer, recorder
        self._sample_rows = sample_rows

    def render(self, index: int, due_ns: int, exposures: Sequence[Exposure | None]) -> FrameSet:
        """Render the frame set due at a time; an exposure that is None is a camera without a frame."""
        frames = (
            None if exposure is None else camera.develop(exposure)
            for camera, exposure in zip(self._cameras, exposures, strict=True)
        )
        return FrameSet(index, tuple(frames), due_ns)

    def measure(self, frame_set: FrameSet, samples: FrameSamples) -> FrameResult:
        """Measure the next frame set."""
        rows = np.frombuffer(samples.rows, self._sample_rows)
        frame_set = replace(frame_set, reading=samples.reading)
        row = self._observer.step(
            frame_set, rows["t_ns"], rows["measured_pa"], samples.protocol_s, samples.dropped, samples.weight_kg,
            rows["protocol_s"], auxiliary_values(rows),
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
        """Frame sets whose results have not been returned."""
        self._unsent: list[_Request] = []
        self._received: deque[FrameResult | _Failure] = deque()
        self._batches: SimpleQueue[list[FrameResult | _Failure] | None] = SimpleQueue()
        size = MOST_IN_FLIGHT * cameras * shape[0] * shape[1]
        memory = mmap.mmap(-1, max(1, size))
        pictures = np.frombuffer(memory, np.uint8, size).reshape(MOST_IN_FLIGHT, cameras, *shape)
        exposures, self._exposures = _wide_pipe()
        samples, self._samples = _wide_pipe()
        frame_sets, rendered = _wide_pipe()
        self._results, results = _wide_pipe()
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
        # Reads while this process writes: a pipe has little room, and two processes that both write would wait forever.
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def __enter__(self) -> FramePipeline:
        return self

    def __exit__(self, *error: object) -> None:
        for pipe in (self._exposures, self._samples):
            pipe.close()
        for child in self._children.values():
            child.kill()
            child.join()
        self._reader.join()
        self._results.close()

    def submit(self, index: int, due_ns: int, exposures: Sequence[Exposure | None], samples: FrameSamples) -> None:
        """Pass on the next frame set, due at a time. Raises FrameProcessError: a child has ended."""
        assert self.in_flight < MOST_IN_FLIGHT
        self._unsent.append(((index, due_ns, exposures), samples))
        self.in_flight += 1
        if len(self._unsent) == _BATCH:
            self._send()

    def result(self) -> FrameResult:
        """Wait for the result of the oldest frame set in flight.

        Raises:
            FrameProcessError: a child has failed or ended; no frame set is in flight then.
        """
        if not self._received and self.in_flight == len(self._unsent):
            self._send()
        if not self._received:
            batch = self._batches.get()
            if batch is None:
                raise self._ended()
            self._received.extend(batch)
        result = self._received.popleft()
        if isinstance(result, _Failure):
            self.in_flight = 0
            raise FrameProcessError(result.message, result.traceback)
        self.in_flight -= 1
        return result

    def _send(self) -> None:
        requests, self._unsent = self._unsent, []
        try:
            self._exposures.send([exposed for exposed, _ in requests])
            self._samples.send([samples for _, samples in requests])
        except OSError as error:
            raise self._ended() from error

    def _read(self) -> None:
        """Receive batches of results; None says that no more will come."""
        try:
            while True:
                self._batches.put(self._results.recv())
        except _CLOSED:
            self._batches.put(None)

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
    """Render batches of frame sets into the slots of the shared memory, in turn."""
    slot = 0
    while True:
        batch: list[tuple[int, FrameSet] | _Failure] = []
        for index, due_ns, exposed in exposures.recv():
            try:
                frame_set = stages.render(index, due_ns, exposed)
            except Exception as error:
                rendered.send([*batch, _failure(error)])
                return
            without_pictures = tuple(map(_copied, pictures[slot], frame_set.frames))
            batch.append((slot, replace(frame_set, frames=without_pictures)))
            slot = (slot + 1) % len(pictures)
        rendered.send(batch)


def _copied(slot: NDArray[np.uint8], frame: Frame | None) -> Frame | None:
    """Copy the picture of a frame into the shared memory; an empty one of its size stays in the frame."""
    if frame is None:
        return None
    height, width = frame.image.shape
    slot[:height, :width] = frame.image
    return replace(frame, image=np.empty((height, width, 0), np.uint8))


def _measure(
    stages: FrameStages,
    frame_sets: Connection,
    pictures: NDArray[np.uint8],
    samples: Connection,
    results: Connection,
) -> None:
    """Measure batches of frame sets whose pictures are in the shared memory."""
    while True:
        batch: list[FrameResult | _Failure] = []
        for rendered, at_frame in zip(frame_sets.recv(), samples.recv(), strict=False):
            if isinstance(rendered, _Failure):
                results.send([*batch, rendered])
                return
            slot, frame_set = rendered
            frames = tuple(map(_in_memory, frame_set.frames, pictures[slot]))
            try:
                batch.append(stages.measure(replace(frame_set, frames=frames), at_frame))
            except Exception as error:
                results.send([*batch, _failure(error)])
                return
        results.send(batch)


def _in_memory(frame: Frame | None, slot: NDArray[np.uint8]) -> Frame | None:
    """A frame whose picture stays in the shared memory."""
    if frame is None:
        return None
    height, width, _ = frame.image.shape
    return replace(frame, image=slot[:height, :width])


def _failure(error: Exception) -> _Failure:
    return _Failure(f"{type(error).__name__}: {error}", "".join(traceback.format_exception(error)))


def _wide_pipe() -> tuple[Connection, Connection]:
    """A pipe, its ends for reading and for writing; as wide as the system allows."""
    reading, writing = _FORK.Pipe(duplex=False)
    with suppress(OSError, AttributeError):  # macOS has no such width
        fcntl.fcntl(writing.fileno(), fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
    return reading, writing


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
