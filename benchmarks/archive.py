"""What recording, finalising, opening and reporting a run cost.

    python benchmarks/archive.py [--seconds 600] [--channels 8] [--control-hz 1000] [--cameras 2] [--picture-kb 30]

By default a 10-minute run of 1 kHz x 8 channels beside two cameras at 30 Hz of which every third picture is kept.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

import runs
from runs import report
from runs.archive import finalise, verify
from runs.journal import JournalWriter
from runs.records import Interval, Picture, RunFooter, RunHeader, Status, observation_dtype, sample_dtype
from runs.summary import summarise

CAMERA_HZ = 30
KEEP_EVERY = 3


def header(options: argparse.Namespace) -> RunHeader:
    """A run of steps of 4 s."""
    intervals = tuple(
        Interval(float(t), t + 4.0, "dwell", f"{t} s", (1e4 + 10.0 * t,) * options.channels)
        for t in range(0, options.seconds, 4)
    )
    return RunHeader(
        run_id="benchmark",
        title="Benchmark",
        started_utc_ns=0,
        started_t_ns=0,
        protocol_name="steps",
        protocol_yaml="",
        rig_name="none",
        rig_yaml="",
        actuators=options.channels,
        valves=options.channels,
        executor="benchmark",
        simulated=True,
        seed=0,
        model_variant="none",
        operator="",
        notes="",
        command="",
        host="",
        intervals=intervals,
        control_hz=options.control_hz,
        camera_hz=CAMERA_HZ,
    )


def record(path: Path, options: argparse.Namespace) -> float:
    """Write the journal in batches of one camera frame; return the CPU time that it took [s]."""
    rng = np.random.default_rng(0)
    ticks, frames = options.control_hz, CAMERA_HZ * options.cameras
    samples = np.zeros(ticks, sample_dtype(options.channels, options.channels))
    noise = rng.normal(0, 100, (ticks, options.channels))
    rows = np.zeros(frames, observation_dtype(options.channels))
    rows["covariance_m2"], rows["model_ok"] = np.eye(3) * 1e-8, 1
    picture = rng.integers(0, 256, options.picture_kb * 1000, dtype=np.uint8).tobytes()
    began = time.process_time()
    writer = JournalWriter(path, header(options))
    for second in range(options.seconds):
        at = second + np.arange(ticks) / ticks
        samples["t_ns"], samples["protocol_s"] = at * 1e9, at
        samples["setpoint_pa"] = 1e4 + 10.0 * (second // 4 * 4)
        samples["measured_pa"] = samples["setpoint_pa"] + noise
        seen = second + np.arange(frames) / frames
        rows["t_ns"], rows["protocol_s"] = seen * 1e9, seen
        rows["measured_m"] = rng.normal((second * 1e-4, 0, 0.17), 1e-4, (frames, 3))
        rows["model_m"] = rows["truth_m"] = (second * 1e-4, 0, 0.17)
        for k in range(frames):
            writer.samples(samples[k * ticks // frames : (k + 1) * ticks // frames])
            writer.observations(rows[k : k + 1])
            if k % KEEP_EVERY == 0:
                writer.picture(Picture(int(rows["t_ns"][k]), second * frames + k, "front", "jpeg", picture))
    writer.close(RunFooter(options.seconds * 10**9, Status.FINISHED, ""))
    print(f"longest fdatasync        {writer.longest_sync_s * 1e3:8.1f} ms")
    return time.process_time() - began


def main() -> None:
    """Print the costs."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name, default in (("seconds", 600), ("channels", 8), ("control-hz", 1000), ("cameras", 2), ("picture-kb", 30)):
        parser.add_argument(f"--{name}", type=int, default=default)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        cpu = record(path, options)
        print(f"recording                {100 * cpu / options.seconds:8.2f} % of a core")
        print(f"{'.mcap':24} {path.stat().st_size / 1e6:8.1f} MB")
        for name, step in (
            ("finalise", lambda: finalise(path)),
            ("verify", lambda: verify(path.with_suffix(".h5"))),
            ("open, read, summarise", lambda: summarise(runs.open(path.with_suffix(".h5")))),
            ("report", lambda: report.write(path.with_suffix(".h5"))),
        ):
            began = time.perf_counter()
            step()
            print(f"{name:24} {time.perf_counter() - began:8.2f} s")
        for kind in (".h5", ".html"):
            print(f"{kind:24} {path.with_suffix(kind).stat().st_size / 1e6:8.1f} MB")


if __name__ == "__main__":
    main()
