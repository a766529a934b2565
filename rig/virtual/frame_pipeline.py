"""Frame pipeline of a virtual run: a child process renders the frame sets and measures them."""

from __future__ import annotations

import fcntl
import multiprocessing
import signal
import threading
import traceback
import warnings
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from queue import SimpleQueue

import numpy as np

from rig.hardware.cameras.base import FrameSet
from rig.hardware.trackers.base import TrackerReading
from rig.observation.observer import Observer
from rig.observation.picture_recorder import PictureRecorder
from rig.simulator.mock_camera import Exposure, MockCamera
from runs.records import Picture

_BATCH = 6
"""Frame sets in one message: a message costs several times what its content does."""
_PIPE_BYTES = 1 << 20
"""Room for the pictures of some batches: through a pipe of the usual 64 KiB a batch travels in pieces."""
_FORK = multiprocessing.get_context("fork")
_CLOSED = (EOFError, OSError)


@dataclass(frozen=True)
class FrameRequest:
    """A frame set to measure, and what the observer needs beside the pictures.

    `exposures` are those of the cameras, None for a camera without a frame. `rows` are the samples since the last frame
    set as bytes of the rows that the run records, `protocol_s` and `weight_kg` the protocol time of the newest one and
    the weight on the end cap; `dropped`: the frames or readings before. With a tracker its `reading`, None where it was
    silent.
    """

    index: int
    t_ns: int
    rows: bytes
    protocol_s: float
    weight_kg: float
    dropped: int
    exposures: Sequence[Exposure | None] = ()
    reading: TrackerReading | None = None


@dataclass(frozen=True)
class FrameResult:
    """The observer's row and that of its estimator as bytes (None without an estimator), and the pictures to record."""

    observation: bytes
    adaptation: bytes | None
    pictures: list[Picture]


class FrameProcessError(Exception):
    """The child process has failed or ended; the notes hold its traceback if there is one."""


class FrameStages:
    """The two stages of a frame set: the cameras' pictures, then the observer's row."""

    def __init__(
        self,
        cameras: Sequence[MockCamera],
        observer: Observer,
        recorder: PictureRecorder,
        sample_rows: np.dtype[np.void],
    ) -> None:
        """`sample_rows` is the type of the rows of a `FrameRequest`."""
        self._cameras, self._observer, self._recorder = cameras, observer, recorder
        self._sample_rows = sample_rows

    def render(self, request: FrameRequest) -> FrameSet:
        """Render the next frame set."""
        frames = (
            None if exposure is None else camera.develop(exposure)
            for camera, exposure in zip(self._cameras, request.exposures, strict=False)
        )
        return FrameSet(request.index, tuple(frames), request.t_ns, request.reading)

    def measure(self, request: FrameRequest) -> FrameResult:
        """Render and measure the next frame set."""
        frame_set, rows = self.render(request), np.frombuffer(request.rows, self._sample_rows)
        row = self._observer.step(frame_set, rows, request.protocol_s, request.dropped, request.weight_kg)
        adaptation = self._observer.adaptation
        return FrameResult(
            row.tobytes(),
            None if adaptation is None else adaptation.tobytes(),
            self._recorder.pictures(frame_set, self._observer),
        )


class FramePipeline:
    """Runs the stages of every frame set in a child process, in the order of the frame sets.

    The child is forked: it shares imported libraries and compiled kernels with this process. It ends when its pipes
    close, and so with this process.
    """

    def __init__(self, stages: FrameStages) -> None:
        """Start the child."""
        self.in_flight = 0
        """Frame sets whose results have not been returned."""
        self._unsent: list[FrameRequest] = []
        self._received: SimpleQueue[FrameResult | FrameProcessError | None] = SimpleQueue()
        requests, self._requests = _wide_pipe()
        self._results, results = _wide_pipe()

        def child() -> None:
            # A signal to the whole process group is for the parent, which ends the run in order.
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                signal.signal(number, signal.SIG_IGN)
            for pipe in (self._requests, self._results):
                pipe.close()
            with suppress(*_CLOSED):
                while True:
                    results.send([_measured(stages, request) for request in requests.recv()])

        self._child = _FORK.Process(target=child, daemon=True)
        with warnings.catch_warnings():
            # Python warns of every fork beside other threads. Those of NumPy survive a fork, and no other is started
            # before the child.
            warnings.simplefilter("ignore", DeprecationWarning)
            self._child.start()
        for pipe in (requests, results):
            pipe.close()
        # Reads while this process writes: a pipe has little room, and two processes that both write would wait forever.
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def __enter__(self) -> FramePipeline:
        return self

    def __exit__(self, *error: object) -> None:
        self._requests.close()
        self._child.kill()
        self._child.join()
        self._reader.join()
        self._results.close()

    def submit(self, request: FrameRequest) -> None:
        """Pass on the next frame set. Raises FrameProcessError: the child has ended."""
        self._unsent.append(request)
        self.in_flight += 1
        if len(self._unsent) == _BATCH:
            self._send()

    def result(self) -> FrameResult:
        """Wait for the result of the oldest frame set in flight.

        Raises:
            FrameProcessError: the child has failed or ended; no frame set is in flight then.
        """
        if self.in_flight == len(self._unsent):
            self._send()
        result = self._received.get()
        if result is None:
            raise self._ended()
        if isinstance(result, FrameProcessError):
            self.in_flight = 0
            raise result
        self.in_flight -= 1
        return result

    def _send(self) -> None:
        requests, self._unsent = self._unsent, []
        try:
            self._requests.send(requests)
        except OSError as error:
            raise self._ended() from error

    def _read(self) -> None:
        """Receive batches of results; None says that no more will come."""
        with suppress(*_CLOSED):
            while True:
                for result in self._results.recv():
                    self._received.put(result)
        self._received.put(None)

    def _ended(self) -> FrameProcessError:
        self.in_flight = 0
        self._child.join(timeout=1.0)
        return FrameProcessError(
            f"the process that renders and measures the pictures ended with exit code {self._child.exitcode}"
        )


class InlineFrames:
    """`FramePipeline` without a child process, for a process that may start none."""

    def __init__(self, stages: FrameStages) -> None:
        self._stages = stages
        self._results: deque[FrameResult] = deque()

    @property
    def in_flight(self) -> int:
        """Frame sets whose results have not been returned."""
        return len(self._results)

    def __enter__(self) -> InlineFrames:
        return self

    def __exit__(self, *error: object) -> None:
        self._results.clear()

    def submit(self, request: FrameRequest) -> None:
        """Measure the next frame set. Raises FrameProcessError: it failed."""
        result = _measured(self._stages, request)
        if isinstance(result, FrameProcessError):
            raise result
        self._results.append(result)

    def result(self) -> FrameResult:
        """Return the result of the oldest frame set in flight."""
        return self._results.popleft()


def may_fork() -> bool:
    """Whether this process may fork a child: not in a worker of Dask, which is daemonic, nor beside its threads."""
    return not multiprocessing.current_process().daemon and threading.current_thread() is threading.main_thread()


def _measured(stages: FrameStages, request: FrameRequest) -> FrameResult | FrameProcessError:
    try:
        return stages.measure(request)
    except Exception as error:
        failure = FrameProcessError(f"{type(error).__name__}: {error}")
        failure.add_note("".join(traceback.format_exception(error)))
        return failure


def _wide_pipe() -> tuple[Connection, Connection]:
    """A pipe, its ends for reading and for writing; as wide as the system allows."""
    reading, writing = _FORK.Pipe(duplex=False)
    with suppress(OSError, AttributeError):  # macOS has no such width
        fcntl.fcntl(writing.fileno(), fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
    return reading, writing
