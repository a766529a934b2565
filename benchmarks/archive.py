"""What recording, finalising, opening and reporting a run cost.

    python -m benchmarks.archive [--seconds 600] [--channels 8] [--control-hz 1000] [--cameras 2] [--keep-every 3]
                                 [--archives 10000]

By default a 10-minute run of 1 kHz x 8 channels beside two 640x480 cameras at 30 Hz. Every third picture is
kept, as a rig does that says nothing else; encoding it as JPEG counts as recording. Then the first and the second look
at a folder of so many archives. CPU time, and beside it the time that a machine with other work took.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

import runs
from runs.archive.digest import checked
from runs.archive.writer import finalise
from runs.catalogue import catalogue
from runs.journal.journal import JournalWriter
from runs.records import (
    BACKBONE_POINTS,
    ImageAnnotations,
    Picture,
    PlayedSegment,
    RunFooter,
    RunHeader,
    Status,
    observation_dtype,
    sample_dtype,
)
from runs.report import page as report
from runs.summary import summarise

CAMERA_HZ = 30


def header(options: argparse.Namespace) -> RunHeader:
    """A run of steps of 4 s."""
    intervals = tuple(
        PlayedSegment(float(t), t + 4.0, "dwell", f"{t} s", (1e4 + 10.0 * t,) * options.channels)
        for t in range(0, options.seconds, 4)
    )
    return RunHeader(
        run_id="benchmark",
        title="Benchmark",
        started_utc_ns=0,
        started_t_ns=0,
        protocol_name="steps",
        rig_name="none",
        actuators=options.channels,
        valves=options.channels,
        executor="benchmark",
        simulated=True,
        seed=0,
        model_variant="none",
        intervals=intervals,
        control_hz=options.control_hz,
        camera_hz=CAMERA_HZ,
    )


def record(path: Path, options: argparse.Namespace) -> float:
    """Write the journal in batches of one camera frame; return the CPU time that it took [s]."""
    rng = np.random.default_rng(0)
    cycles, frames = options.control_hz, CAMERA_HZ * options.cameras
    samples = np.zeros(cycles, sample_dtype(options.channels, options.channels))
    noise = rng.normal(0, 100, (cycles, options.channels))
    rows = np.zeros(frames, observation_dtype(options.channels))
    rows["covariance_m2"], rows["model_ok"] = np.eye(3) * 1e-8, 1
    image = np.clip(np.linspace(40, 200, 640) + rng.normal(0, 2, (480, 640)), 0, 255).astype(np.uint8)
    marks = ImageAnnotations.of(np.ones((20, 2)), np.ones(2), np.ones(2), np.ones((BACKBONE_POINTS, 2)))
    began = time.process_time()
    writer = JournalWriter(path, header(options), live=True)
    for second in range(options.seconds):
        at = second + np.arange(cycles) / cycles
        samples["t_ns"], samples["protocol_s"] = at * 1e9, at
        samples["setpoint_pa"] = 1e4 + 10.0 * (second // 4 * 4)
        samples["measured_pa"] = samples["setpoint_pa"] + noise
        seen = second + np.arange(frames) / frames
        rows["t_ns"], rows["protocol_s"] = seen * 1e9, seen
        rows["measured_m"] = rng.normal((second * 1e-4, 0, 0.17), 1e-4, (frames, 3))
        rows["model_m"] = rows["truth_m"] = (second * 1e-4, 0, 0.17)
        for k in range(frames):
            writer.samples(samples[k * cycles // frames : (k + 1) * cycles // frames])
            writer.observations(rows[k : k + 1])
            if k % options.keep_every == 0:
                data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()
                writer.picture(Picture(int(rows["t_ns"][k]), second * frames + k, "front", "jpeg", data, marks))
    writer.close(RunFooter(options.seconds * 10**9, Status.FINISHED, ""))
    return time.process_time() - began


def timed(name: str, step: Callable[[], object]) -> None:
    """Print what a step costs."""
    began, cpu = time.perf_counter(), time.process_time()
    step()
    print(f"{name:24} {time.process_time() - cpu:8.2f} s of CPU, {time.perf_counter() - began:8.2f} s", flush=True)


def folder_of(archives: int, source: Path, folder: Path) -> None:
    """Many names of one small archive: each is read as if it were a file of its own."""
    folder.mkdir()
    for number in range(archives):
        (folder / f"{number:05d}.h5").hardlink_to(source)


def main() -> None:
    """Print the costs."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name, default in (
        ("seconds", 600),
        ("channels", 8),
        ("control-hz", 1000),
        ("cameras", 2),
        ("keep-every", 3),
        ("archives", 10_000),
    ):
        parser.add_argument(f"--{name}", type=int, default=default)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        cpu = record(path, options)
        print(f"recording                {100 * cpu / options.seconds:8.2f} % of a core")
        print(f"{'.mcap':24} {path.stat().st_size / 1e6:8.1f} MB")
        for name, step in (
            ("finalise", lambda: finalise(path)),
            ("digest", lambda: checked(path.with_suffix(".h5"))),
            ("open, read, summarise", lambda: summarise(runs.open(path.with_suffix(".h5")))),
            ("report", lambda: report.write(path.with_suffix(".h5"))),
        ):
            timed(name, step)
        for kind in (".h5", ".html"):
            print(f"{kind:24} {path.with_suffix(kind).stat().st_size / 1e6:8.1f} MB")
        if options.archives:
            small = Path(folder) / "small.mcap"
            record(small, argparse.Namespace(**vars(options) | {"seconds": 2}))
            many = Path(folder) / "many"
            folder_of(options.archives, finalise(small), many)
            timed(f"{options.archives} archives, first", lambda: catalogue(many))
            timed(f"{options.archives} archives, again", lambda: catalogue(many))


if __name__ == "__main__":
    main()
