"""The observer process: camera, vision and model, at the camera's pace."""

from __future__ import annotations

import signal
import sys
import time
from dataclasses import replace

import numpy as np

from rig.cameras import open_camera
from rig.cameras.base import CameraError, Frame
from rig.executor.child import Job, orphaned, receive
from rig.executor.memory import RunMemory, Stage, Stop
from rig.executor.pictures import encode
from rig.executor.showing import Show
from rig.executor.standin import forsaken, outlive
from rig.observer import Observer

REHEARSED_FRAMES = 3
HISTORY = 400
"""Control ticks handed to the model with each frame: two seconds at 200 Hz."""


def main() -> int:
    """Observe until told to stop."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    job, memory = receive()
    try:
        return _observe(job, memory)
    except CameraError as error:
        memory.say("observer", Stage.FAILED, str(error))
        return 1


def _observe(job: Job, memory: RunMemory) -> int:
    config = job.plan.config
    name = next(iter(config.cameras))
    observer = Observer(config, job.plan.variant)
    show = Show(config, name, memory)
    camera = open_camera(config, name, job.plan.seed)
    try:
        # A camera that shows nothing is found before the run is armed.
        _rehearse(job, [camera.read(timeout_s=5.0) for _ in range(REHEARSED_FRAMES)])
        memory.say("observer", Stage.READY)
        previous: int | None = None
        while memory.get("stop") == Stop.NONE and not orphaned(job):
            memory.beat("observer", time.monotonic_ns())
            if forsaken(memory):
                outlive(config, memory)
                continue
            try:
                frame = camera.read(timeout_s=config.limits.no_tip_s)
            except CameraError:
                if memory.get("stop") != Stop.NONE:
                    break
                raise
            go = memory.get("go_ns")
            if not go or frame.t_ns < go:
                continue
            dropped = 0 if previous is None else max(0, frame.index - previous - 1)
            previous = frame.index
            _record(job, observer, memory, frame, dropped)
            show.frame(frame, observer)
            if frame.index % config.recording.keep_every == 0:
                memory.push_picture(frame.t_ns, frame.index, encode(frame.image, config.recording))
    finally:
        camera.close()
    if orphaned(job):
        outlive(config, memory)
    memory.say("observer", Stage.DONE)
    return 0


def _rehearse(job: Job, frames: list[Frame]) -> None:
    """Observe some frames with an observer of their own: what is compiled at its first use is ready by then."""
    config = job.plan.config
    observer = Observer(config, job.plan.variant)
    for index, frame in enumerate(frames):
        times = np.array([frame.t_ns])
        observer.step(replace(frame, index=index), times, np.zeros((1, config.actuators)), 0.0)


def _record(job: Job, observer: Observer, memory: RunMemory, frame: Frame, dropped: int) -> None:
    ticks = memory.samples.last(HISTORY)
    if not len(ticks):
        return
    latest = ticks[max(0, int(ticks["t_ns"].searchsorted(frame.t_ns, side="right")) - 1)]
    protocol_s = float(latest["protocol_s"])
    weight_kg = job.plan.trajectory.weight_kg(protocol_s)
    row = observer.step(frame, ticks["t_ns"], ticks["measured_pa"], protocol_s, dropped, weight_kg)
    row["age_ns"] = time.monotonic_ns() - frame.t_ns
    memory.observations.push(row)


if __name__ == "__main__":
    sys.exit(main())
