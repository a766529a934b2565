"""Camera synchroniser: combines the frames of all cameras of a rig into frame sets, paired by their times.

A single camera is read directly. Of several cameras each is read by its own thread; the first camera that delivers
pictures leads, and each other camera contributes its frame nearest in time, at most half a period away.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence

from rig.config.schema import RigConfig
from rig.hardware.cameras.base import Camera, CameraError, Frame, FrameSet, open_camera
from rig.hardware.cameras.trigger import PulseRows, TriggeredCamera
from rig.hardware.driver_calls import release

KEPT = 4
"""Buffered frames per camera."""
PATIENCE = 1.5
"""Periods that a frame waits for frames of the other cameras, which may arrive later."""
STALL_PERIODS = 2.0
"""A longer gap between two reads is a stall of this process, which does not count as silence of the cameras."""
RETRY_S = 0.1
POLL_S = 0.5


class CameraSynchroniser:
    """All cameras of a rig, open."""

    def __init__(self, config: RigConfig, seed: int, pulses: Callable[[], PulseRows] | None = None) -> None:
        """Open every camera. `pulses` returns the recent pulses (n,) that trigger them; None for the own clocks.

        Raises:
            CameraError: one of them cannot be opened.
        """
        self._names = list(config.cameras)
        self._least = config.limits.least_cameras
        self._period_ns = round(1e9 / next(iter(config.cameras.values())).rate_hz)
        self._cameras: list[Camera] = []
        self._readers: list[_Reader] = []
        self._changed = threading.Condition()
        self._looked_ns = time.monotonic_ns()
        self._leader = 0
        self._offset = 0
        self._last: tuple[int, int] | None = None
        try:
            for name in config.cameras:
                camera = open_camera(config, name, seed)
                if pulses is not None:
                    camera = TriggeredCamera(name, config.cameras[name], camera, pulses)
                self._cameras.append(camera)
        except BaseException:
            self.close()
            raise
        if len(self._cameras) > 1:
            self._readers = [_Reader(camera, self._changed) for camera in self._cameras]

    def await_all(self, timeout_s: float) -> None:
        """Wait until every camera has given a picture. Raises CameraError: a camera has not."""
        with self._changed:
            self._changed.wait_for(lambda: all(r.newest_ns for r in self._readers), timeout_s)
            for name, reader in zip(self._names, self._readers, strict=False):
                if not reader.newest_ns:
                    why = reader.failure or f"no picture within {timeout_s:g} s"
                    raise CameraError(f"camera {name}: {why}")

    def read(self, timeout_s: float) -> FrameSet:
        """Return the newest frame set, waiting for one that was not returned before.

        Raises:
            CameraError: fewer cameras than `least_cameras` have given a picture within `timeout_s`.
        """
        if not self._readers:
            return FrameSet.of(self._cameras[0].read(timeout_s))
        until = time.monotonic() + timeout_s
        with self._changed:
            while True:
                self._exclude_stall()
                self._check(timeout_s)
                frame_set = self._pair()
                if frame_set is not None:
                    return frame_set
                if time.monotonic() > until:
                    raise CameraError(f"no camera gave a picture within {timeout_s:g} s")
                # With a time-out: the wait for a late camera ends by the clock.
                self._changed.wait(self._period_ns * 0.1e-9)

    def close(self) -> None:
        for reader in self._readers:
            reader.stop()
        release(self._cameras)

    def _exclude_stall(self) -> None:
        """Exclude a stall of this process from the silence of the cameras."""
        before, self._looked_ns = self._looked_ns, time.monotonic_ns()
        stall_ns = self._looked_ns - before - round(STALL_PERIODS * self._period_ns)
        if stall_ns > 0:
            for reader in self._readers:
                reader.arrived_ns = min(reader.arrived_ns + stall_ns, self._looked_ns)

    def _check(self, timeout_s: float) -> None:
        now = time.monotonic_ns()
        lost = [k for k, r in enumerate(self._readers) if now - r.arrived_ns > timeout_s * 1e9]
        if len(self._readers) - len(lost) < self._least:
            reasons = "; ".join(
                f"camera {self._names[k]}: {self._readers[k].failure or f'no picture within {timeout_s:g} s'}"
                for k in lost
            )
            raise CameraError(reasons)

    def _pair(self) -> FrameSet | None:
        """The next frame set; None while there is none.

        It is the newest one that is complete or has waited for the longest time allowed.
        """
        now, period = time.monotonic_ns(), self._period_ns
        silent = [now - reader.arrived_ns > 2 * period for reader in self._readers]
        leader = next((k for k, quiet in enumerate(silent) if not quiet), None)
        if leader is None:
            return None
        # A new leading camera may have pictures older than the last frame set of the previous one.
        after_ns = -1 if self._last is None else self._last[1] + period // 2
        for lead, arrived_ns in reversed(self._readers[leader].waiting):
            if lead.t_ns <= after_ns:
                return None
            frames, complete = self._matching_frames(leader, lead, silent)
            if complete or now - arrived_ns > PATIENCE * period:
                break
        else:
            return None
        for reader, frame in zip(self._readers, frames, strict=True):
            until_ns = frame.t_ns if frame is not None else lead.t_ns - period
            while reader.waiting and reader.waiting[0][0].t_ns <= until_ns:
                reader.waiting.popleft()
        return FrameSet(self._number(leader, lead), tuple(frames))

    def _matching_frames(self, leader: int, lead: Frame, silent: Sequence[bool]) -> tuple[list[Frame | None], bool]:
        """The frame of each camera that matches the leading one, and whether no missing frame can still arrive."""
        frames: list[Frame | None] = [None] * len(self._readers)
        frames[leader], complete = lead, True
        for k, reader in enumerate(self._readers):
            # Cameras before the leading one are silent.
            if k <= leader:
                continue
            nearest = min(reader.waiting, key=lambda w: abs(w[0].t_ns - lead.t_ns), default=None)
            if nearest is not None and abs(nearest[0].t_ns - lead.t_ns) <= self._period_ns // 2:
                frames[k] = nearest[0]
            elif not silent[k] and reader.newest_ns < lead.t_ns:
                complete = False
        return frames, complete

    def _number(self, leader: int, lead: Frame) -> int:
        """Number of the frame set: the count of the leading camera, continued when another camera leads."""
        if self._last is not None and leader != self._leader:
            index, t_ns = self._last
            self._offset = index + max(1, round((lead.t_ns - t_ns) / self._period_ns)) - lead.index
        self._leader = leader
        self._last = lead.index + self._offset, lead.t_ns
        return self._last[0]


class _Reader:
    """Thread that reads one camera continuously and retries after a failure."""

    def __init__(self, camera: Camera, changed: threading.Condition) -> None:
        self.waiting: deque[tuple[Frame, int]] = deque(maxlen=KEPT)
        """Frames that are not yet part of a frame set, with their times of arrival."""
        self.newest_ns = 0
        self.arrived_ns = time.monotonic_ns()
        self.failure = ""
        self._camera, self._changed = camera, changed
        self._stopped = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread, which may still wait for a picture."""
        self._stopped = True
        self._thread.join(2 * POLL_S)

    def _run(self) -> None:
        while not self._stopped:
            try:
                frame = self._camera.read(POLL_S)
            except CameraError as error:
                self.failure = str(error)
                time.sleep(RETRY_S)
                continue
            with self._changed:
                self.failure = ""
                self.newest_ns, self.arrived_ns = frame.t_ns, time.monotonic_ns()
                self.waiting.append((frame, self.arrived_ns))
                self._changed.notify_all()
