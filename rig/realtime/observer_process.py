"""The observer process: camera, vision and model, at the camera rate."""

from __future__ import annotations

import signal
import time
from dataclasses import replace
from functools import partial

import numpy as np

from calibration.vision.warm_up import warm_up
from rig.config.optics import board_of, plane_of
from rig.config.schema import RigConfig
from rig.execution.plan import sample_rows
from rig.hardware.cameras.base import FrameSet
from rig.hardware.cameras.synchroniser import CameraSynchroniser
from rig.hardware.cameras.trigger import RECENT_PULSES
from rig.hardware.driver_calls import TipSourceError
from rig.hardware.trackers.base import TrackerError, other_sender
from rig.observation.frame_sources import PredictionClock, TrackerSource
from rig.observation.observer import Observer
from rig.observation.overlay import OverlayProjector, arm_lines
from rig.observation.picture_recorder import PictureRecorder
from rig.realtime.child_process import ChildJob, await_device_access, exit_process, receive_job, supervisor_monitor
from rig.realtime.failsafe import FailsafeThread
from rig.realtime.picture_rings import LINE_POINTS, view_dtype
from rig.realtime.shared_state import SharedState, Stage, Stop
from rig.realtime.timing_limits import timing_limits

WARM_UP_FRAMES = 3
FIRST_PICTURE_S = 5.0
HISTORY_S = 2.0
"""Time before a frame whose control cycles are passed to the model with it."""
WATCHED_NS = 3_000_000_000
"""A viewer reports its presence about once a second."""
VIEW_EVERY_NS = 100_000_000
"""Least time between two frames for viewers; each costs the observer a copy, and a page a JPEG."""
LATE_VIEW_EVERY_NS = 1_000_000_000
"""The same while the observer is behind the camera: whoever watches must not cost frames."""
AT_ONCE_NS = 1_000_000
"""A frame that is read within this time has waited for the observer."""
_NO_PICTURE = np.empty((0, 0, 0), np.uint8)


def main() -> int:
    """Observe until a stop is requested; end once the bench is safe."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    job, memory = receive_job()
    failsafe = FailsafeThread(job, memory)
    try:
        _observe(job, memory)
    except TipSourceError as error:
        memory.publish_stage("observer", Stage.FAILED, str(error))
        return 1
    except Exception as error:
        memory.publish_stage("observer", Stage.FAILED, f"the observer process failed: {type(error).__name__}: {error}")
        raise
    finally:
        failsafe.join()
    memory.publish_stage("observer", Stage.DONE)
    return 0


def _observe(job: ChildJob, memory: SharedState) -> None:
    config = job.plan.config
    frame_s = timing_limits(config, memory.granted).frame_s
    observer = _observer(job)
    preview = PreviewPublisher(config, memory)
    recorder, names = PictureRecorder(config), list(config.cameras)
    supervisor = supervisor_monitor(job)
    if not await_device_access(memory, supervisor, lambda: _may_open(config, memory)):
        return
    source = _source(config, job.plan.seed, memory)
    try:
        # A camera without pictures or a silent tracker is detected before the run is armed.
        source.await_all(max(FIRST_PICTURE_S, frame_s))
        _warm_up(job, [source.read(FIRST_PICTURE_S) for _ in range(WARM_UP_FRAMES)])
        memory.publish_stage("observer", Stage.READY)
        previous: int | None = None
        while memory.stop_request == Stop.NONE and not supervisor.exited:
            memory.heartbeat("observer", time.monotonic_ns())
            asked_ns = time.monotonic_ns()
            try:
                frame_set = source.read(frame_s)
            except TipSourceError:
                if memory.stop_request != Stop.NONE:
                    break
                raise
            arrived_ns = time.monotonic_ns()
            # Frames from the safe state on show the arm as it vents, which no step of the protocol asks for.
            if not _within_run(memory, frame_set.t_ns):
                continue
            if job.plan.controls_tip:
                _refuse_other_sender(frame_set)
            dropped = 0 if previous is None else max(0, frame_set.index - previous - 1)
            previous = frame_set.index
            _record(job, observer, memory, frame_set, dropped)
            for picture in recorder.pictures(frame_set, observer):
                memory.pictures.push(picture, names.index(picture.camera))
            preview.publish(frame_set, observer, behind=dropped > 0 or arrived_ns - asked_ns < AT_ONCE_NS)
    finally:
        source.close()


def _refuse_other_sender(frame_set: FrameSet) -> None:
    """Raise TrackerError if another program sends poses: whichever is right, valves must not follow the wrong one."""
    if frame_set.reading is not None and (ipv4 := frame_set.reading.foreign_ipv4):
        raise TrackerError(f"the tip is controlled and {other_sender(ipv4)}")


def _within_run(memory: SharedState, t_ns: int) -> bool:
    """Whether a time is after the start of the run and before control has written the safe state."""
    started_ns, safe_ns = memory.start_ns, memory.safe_ns
    return bool(started_ns) and started_ns <= t_ns and not (safe_ns and t_ns > safe_ns)


def _may_open(config: RigConfig, memory: SharedState) -> bool:
    """Whether the devices may be opened: triggered cameras give pictures only once control gives pulses."""
    return not memory.simulator_starting and (not config.triggered or memory.stage("control") is not Stage.STARTING)


def _source(config: RigConfig, seed: int, memory: SharedState) -> CameraSynchroniser | TrackerSource | PredictionClock:
    if config.trackers:
        return TrackerSource(config, seed)
    pulses = partial(memory.pulses.last, RECENT_PULSES) if config.triggered else None
    return CameraSynchroniser(config, seed, pulses) if config.cameras else PredictionClock(config)


def _observer(job: ChildJob) -> Observer:
    plan = job.plan
    return Observer(plan.config, plan.variant, [quantity.name for quantity in plan.adapted], plan.trajectory.tip)


def _warm_up(job: ChildJob, frame_sets: list[FrameSet]) -> None:
    """Observe some frame sets with a separate observer, so that imports and compilation are done before the start.

    The board may come into view later: drawn pictures of it are measured, too.
    """
    config = job.plan.config
    for camera in config.cameras.values():
        for board in (board_of(config), *(section.board.board() for section in config.sections.values())):
            warm_up(board, plane_of(config, camera))
    observer = _observer(job)
    for index, frame_set in enumerate(frame_sets):
        samples = np.zeros(1, sample_rows(config))
        samples["t_ns"] = frame_set.t_ns
        observer.step(replace(frame_set, index=index), samples, 0.0)


def _record(job: ChildJob, observer: Observer, memory: SharedState, frame_set: FrameSet, dropped: int) -> None:
    cycles = memory.samples.last(round(HISTORY_S * job.plan.config.control.rate_hz))
    if not len(cycles):
        return
    latest = cycles[max(0, int(cycles["t_ns"].searchsorted(frame_set.t_ns, side="right")) - 1)]
    protocol_s = float(latest["protocol_s"])
    weight_kg = job.plan.trajectory.weight_kg(protocol_s)
    row = observer.step(frame_set, cycles, protocol_s, dropped, weight_kg)
    row["age_ns"] = time.monotonic_ns() - frame_set.t_ns
    memory.observations.push(row)
    if observer.adaptation is not None:
        memory.adaptations.push(observer.adaptation)


class PreviewPublisher:
    """Publishes frames with their overlay to viewers: not every frame, and few while the observer is late.

    Without a viewer nothing is computed or copied.
    """

    def __init__(self, config: RigConfig, memory: SharedState) -> None:
        self._config, self._memory = config, memory
        self._published_ns = self._behind_ns = 0
        self._projectors = [OverlayProjector(config, name) for name in config.cameras]
        self._row = np.zeros((), view_dtype(config))

    def publish(self, frame_set: FrameSet, observer: Observer, behind: bool) -> None:
        """Publish the leading frame of the frame set that the observer has just observed, if there is a viewer.

        `behind`: frames were lost before this one, or the observer found it waiting.
        Without cameras the picture is empty, and the overlay is the lines of the arm.
        """
        now = time.monotonic_ns()
        watched = now - self._memory.viewer_ns <= WATCHED_NS
        if behind:
            self._behind_ns = now
        late = now - self._behind_ns < LATE_VIEW_EVERY_NS
        due = now - self._published_ns >= (LATE_VIEW_EVERY_NS if late else VIEW_EVERY_NS)
        if not (watched and due) or observer.measurement is None:
            return
        self._published_ns = now
        row = self._row
        row["t_ns"], row["frame"] = frame_set.t_ns, frame_set.index
        row["lines_m"] = arm_lines(self._config, observer.shape, LINE_POINTS)
        if not frame_set.frames:
            row["shape"], row["found"], row["tip_px"], row["model_px"] = 0, 0, np.nan, np.nan
            self._memory.views.push(row, _NO_PICTURE)
            return
        frame, measurement = frame_set.lead, observer.measurement
        projector = self._projectors[frame_set.leader]
        marks = projector.annotations(measurement.corners_px, measurement.tip_m, observer.shape)
        corners_px = marks.corners_px[np.isfinite(marks.corners_px).all(axis=1)]
        row["shape"] = (*frame.image.shape, 1)[:3]
        row["found"] = len(corners_px)
        row["corners_px"][: len(corners_px)] = corners_px
        row["tip_px"], row["model_px"] = marks.tip_px, marks.model_px
        self._memory.views.push(row, frame.image)


if __name__ == "__main__":
    exit_process(main())
